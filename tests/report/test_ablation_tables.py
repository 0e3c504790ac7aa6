"""Tables 3, S1, S2 and the table of switches: measured and reported numbers of equal settings."""

from __future__ import annotations

import math

import pytest

from gpf.core.files import read_json
from report.results import Results
from report.tables.ablations import ablation_tables
from tests.report.made_up import BOX, WATER, edit, make_results


@pytest.fixture
def results(tmp_path):
    return make_results(tmp_path / "results")


def frames(results):
    made = ablation_tables(Results(results.params, results.root))
    labels = {table.name: table.label for table in made}
    return {t.name: t.frame.set_index(["scene", labels[t.name]]) for t in made}


def mean(results, *parts):
    return read_json(results.root.joinpath(WATER, *parts))["mean"]


def test_components_are_beside_those_of_the_paper(results):
    frame = frames(results)["table_3"].loc["Water Caustic"]
    assert list(frame.index[:2]) == ["radius only", "all (default)"] and len(frame) == 6
    radius, field = frame.loc["radius only"], frame.loc["all (default)"]
    assert radius["psnr"] == mean(results, "ablations", "radius.json")["psnr"]
    assert radius["psnr_paper"] == 26.73 and field["psnr_paper"] == 27.12
    assert field["psnr"] == mean(results, "metrics", "gpf.json")["psnr"]
    assert radius["psnr_difference"] == pytest.approx(radius["psnr"] - field["psnr"])
    cost = read_json(results.root / WATER / "costs" / "train.json")
    assert field["train_seconds"] == cost["parts"]["training"]["wall_seconds"]
    # The paper's other rows are shown without measured numbers.
    assert (
        math.isnan(frame.loc["kNN only", "psnr"]) and frame.loc["kNN only", "psnr_paper"] == 26.42
    )
    assert frame.loc["kNN only", "reason"] == "no variant in params.yaml has these settings"


def test_numbers_of_gaussians_are_in_order(results):
    frame = frames(results)["table_s1"].loc["Water Caustic"]
    assert list(frame.index) == ["10,000", "50,000", "100,000 (default)", "200,000"]
    assert frame.loc["10,000", "psnr"] == mean(results, "ablations", "few.json")["psnr"]
    assert frame["psnr_paper"].tolist() == [24.32, 26.18, 27.12, 27.25]
    assert frame["seconds_per_view_paper"].tolist() == [7.23, 12.7, 16.37, 24.35]


def test_a_number_that_the_paper_lacks_has_no_paper_values(results):
    edit(results.root / WATER / "costs" / "train.json", facts__gaussians=25_000)
    frame = frames(results)["table_s1"].loc["Water Caustic"]
    labels = ["10,000", "25,000 (default)", "50,000", "100,000", "200,000"]
    assert list(frame.index) == labels
    assert math.isnan(frame.loc["25,000 (default)", "psnr_paper"])


def test_variants_that_were_not_run_say_so(results):
    found = frames(results)
    k = found["table_s2"].loc["Water Caustic"]
    assert list(k.index) == ["1", "3 (default)", "5", "10"]
    assert k.loc["10", "reason"] == "not run" and k.loc["10", "psnr_paper"] == 27.08
    switch = found["switches"].loc[("Water Caustic", "plain sum")]
    assert "not listed in `ablations.run` of params.yaml" in switch["reason"]


def test_a_variant_that_cannot_be_made_gives_its_reason(results):
    row = {"variant": "k_10", "title": "ten", "group": "k", "overrides": {"field.k": 10}}
    file = results.root / WATER / "ablations" / "k_10.json"
    file.write_text(str(row | {"reason": "too few photons", "todo": "More."}).replace("'", '"'))
    k = frames(results)["table_s2"].loc["Water Caustic"]
    assert math.isnan(k.loc["10", "psnr"]) and k.loc["10", "reason"] == "too few photons"


def test_variants_that_are_not_listed_are_not_compared(results):
    """No stage keeps such files up to date; their references may have another size."""
    assert set(frames(results)["table_3"].index.get_level_values(0)) == {"Water Caustic"}
    source = results.root / WATER / "ablations" / "radius.json"
    target = results.root / BOX / "ablations" / "radius.json"
    target.parent.mkdir()
    target.write_bytes(source.read_bytes())
    table = ablation_tables(Results(results.params, results.root))[0]
    assert set(table.frame["scene"]) == {"Water Caustic"}
    left = "On file, but not listed by `ablations` in params.yaml: radius only (Cornell Box)."
    assert table.remarks == (left,)
    # The same for a variant that `ablations.run` no longer lists.
    sections = results.params.model_dump(mode="json")
    sections["ablations"]["run"] = ["all"]
    other = Results(results.params.model_validate(sections), results.root)
    row = ablation_tables(other)[0].frame.set_index("variant")
    assert math.isnan(row.loc["radius only", "psnr"])


def test_a_variant_that_changes_more_keeps_its_title(tmp_path):
    longer = {"group": "k", "title": "k = 10, longer", "set": {"field.k": 10, "train.steps": 9}}
    plain = {"group": "k", "set": {"field.k": 10}}
    variants = {"scenes": [WATER], "run": [], "variants": {"longer": longer, "plain": plain}}
    frame = frames(make_results(tmp_path, ablations=variants))["table_s2"].loc["Water Caustic"]
    assert {"k = 10, longer", "10"} < set(frame.index)


def test_a_variant_may_change_nested_settings(tmp_path):
    deep = {"group": "switches", "title": "slow means", "set": {"train.rates.means": 0.001}}
    alike = {"group": "switches", "title": "as it is", "set": {"train.rates.means": 0.008}}
    variants = {"scenes": [WATER], "run": [], "variants": {"slow": deep, "alike": alike}}
    frame = frames(make_results(tmp_path, ablations=variants))["switches"].loc["Water Caustic"]
    # `alike` changes nothing: it is the default field, which has a row already.
    assert list(frame.index) == ["slow means", "all (default)"]
    assert math.isnan(frame.loc["slow means", "psnr"]) and frame.loc["all (default)", "psnr"] > 0

"""Rows, means, ranks and reasons in the tables of results."""

from __future__ import annotations

import math
import re
from statistics import fmean

import pandas as pd
import pytest

from report.results import NUMBERS, Results
from report.table import MISSING
from report.tables import make_tables, write_tables
from report.writing import to_markdown
from tests.report.made_up import BOX, WATER, cells, edit, make_results, tables_of


@pytest.fixture
def results(tmp_path):
    return make_results(tmp_path / "results")


def test_a_missing_method_is_shown_with_its_reason(results):
    (results.root / BOX / "metrics" / "path_10.json").unlink()
    (results.root / BOX / "costs" / "baselines" / "path_10.json").unlink()
    table = tables_of(results)["table_1"]
    frame = table.frame.set_index(["scene", "method"])
    gone = frame.loc[("Cornell Box", "Path tracer, 10 spp")]
    assert gone[[*NUMBERS, "storage_mb"]].isna().all() and gone["reason"] == "not run"
    assert gone["psnr_paper"] == 30.49
    refused = frame.loc[("Water Caustic", "RenderFormer")]
    assert refused["reason"] == "glass and water are beyond it" and refused["psnr_paper"] == 11.34
    mean = frame.loc[("Mean over 2 scenes", "Path tracer, 10 spp")]
    assert math.isnan(mean["psnr"]) and mean["reason"] == "no number in Cornell Box"
    assert frame.loc[("Mean over 2 scenes", "RenderFormer"), "reason"] == refused["reason"]
    # In Markdown each reason stands once, with a number.
    text = to_markdown(table)
    row = next(line for line in text.splitlines() if "RenderFormer" in line)
    number = re.search(r"RenderFormer<sup>(\d)</sup>", row)[1]
    assert f"{MISSING} (32.14)" in row
    assert text.count("glass and water are beyond it") == 1
    assert f"<sup>{number}</sup> glass and water are beyond it" in text
    assert "Not measured yet: Veach Ajar." in text


def test_a_method_that_is_not_listed_says_so(results):
    methods = {"classical": ["path_10"], "equal_time": [], "learned": []}
    params = results.params.model_validate(
        results.params.model_dump(mode="json") | {"methods": methods}
    )
    frame = tables_of(Results(params, results.root))["table_2"].frame
    row = frame[frame["method"] == "3D Gaussian splatting, 3 views"].iloc[0]
    assert math.isnan(row["psnr"]) and "not listed in `methods` of params.yaml" in row["reason"]


def test_no_cell_is_empty_without_a_reason(results):
    for table in make_tables(results):
        for row in range(len(table.rows)):
            whole = table.label_of(row)[1]
            for column in table.columns:
                text, _, why = table.cell(row, column)
                assert text != MISSING or whole or why, (table.name, row, column.key)


def test_the_papers_means_are_over_the_same_scenes(results):
    frame = tables_of(results)["table_1"].frame.set_index(["scene", "method"])
    for key in ("psnr", "ssim", "psnr_paper", "storage_mb_paper"):
        values = [
            frame.loc[(scene, "GPF, 16 spp"), key] for scene in ("Cornell Box", "Water Caustic")
        ]
        assert frame.loc[("Mean over 2 scenes", "GPF, 16 spp"), key] == pytest.approx(fmean(values))


def test_methods_for_other_scenes_have_no_row(results):
    frame = tables_of(results)["table_1"].frame
    learned = frame[frame["method"] == "3D Gaussian splatting, 3 views"]
    assert list(learned["scene"]) == ["Water Caustic"]
    glance = tables_of(results)["table_1_psnr"].frame
    assert list(glance.columns[:2]) == ["method", BOX] and len(glance) == 6


def test_the_second_reference_and_0_bytes_are_not_ranked(results):
    for scene in (BOX, WATER):
        edit(results.root / scene / "metrics" / "second_reference.json", mean__psnr=99.0)
    frame = tables_of(results)["table_1"].frame
    second = frame[frame["method"] == "SPPM, 30 passes"]
    assert (second["psnr"] == 99).all() and second["psnr_rank"].isna().all()
    assert frame[frame["storage_mb"] == 0]["storage_mb_rank"].isna().all()
    for scene in ("Cornell Box", "Water Caustic"):
        ranked = frame[(frame["scene"] == scene) & frame["psnr_rank"].notna()]
        others = frame[(frame["scene"] == scene) & (frame["method"] != "SPPM, 30 passes")]
        assert (
            ranked.sort_values("psnr_rank")["psnr"].tolist()
            == sorted(others["psnr"].dropna(), reverse=True)[:2]
        )


def test_all_tables_are_written_in_four_formats(results, tmp_path):
    tables = write_tables(results, tmp_path / "tables")
    names = {"table_1_psnr", "table_1", "table_2", "table_3", "table_s1", "table_s2", "switches"}
    assert {t.name for t in tables} == names | {
        "table_4",
        "costs",
        "equal_time",
        "equal_quality",
        "flicker",
    }
    files = {f"{t.name}{suffix}" for t in tables for suffix in (".csv", ".md", ".tex", ".html")}
    assert {path.name for path in (tmp_path / "tables").iterdir()} == files
    written = pd.read_csv(tmp_path / "tables" / "table_1.csv")
    frame = tables[1].frame
    assert list(written.columns) == list(frame.columns)
    assert written["psnr"].tolist() == pytest.approx(frame["psnr"].tolist(), nan_ok=True)


def test_equal_results_give_equal_files(results, tmp_path):
    for name in ("first", "second"):
        write_tables(Results(results.params, results.root), tmp_path / name)
    for path in (tmp_path / "first").iterdir():
        assert path.read_bytes() == (tmp_path / "second" / path.name).read_bytes()


def test_without_any_scene_tables_are_empty_and_say_so(tmp_path):
    results = make_results(tmp_path / "elsewhere")
    for table in make_tables(Results(results.params, tmp_path / "nothing")):
        assert not cells(table.frame.drop(columns=[c for c in table.frame if "_paper" in c]))
        assert "yet" in " ".join(table.notes)


def test_single_numbers_that_are_missing_have_their_own_reasons(results):
    """Without its weights, LPIPS is missing in all tables, with this reason."""
    why, alone = "LPIPS has no weights", "only PSNR was measured at this number of passes"
    for file in [*results.root.glob("*/metrics/*.json"), *results.root.glob("*/ablations/*.json")]:
        if "mean" in file.read_text():
            edit(file, mean__lpips=None, reasons={"lpips": why})
    seen = set()
    for name, table in tables_of(results).items():
        by_key = {column.key: column for column in table.columns}
        for row in range(len(table.rows) if "lpips" in by_key else 0):
            text, _, number = table.cell(row, by_key["lpips"])
            assert text == MISSING, (name, row)
            if table.cell(row, by_key["psnr"])[0] != MISSING:
                passes = "as in references" in table.rows[row].label
                assert table.reasons[int(number) - 1] == (alone if passes else why), (name, row)
                seen.add(name)
    assert seen > {"table_1", "table_2", "table_3", "table_s1", "table_s2", "equal_time"}


def test_references_of_other_numbers_of_passes_are_not_compared(results):
    """This happens after a change of the profile, before its stages have run."""
    text = results.params.model_dump(mode="json")
    text["reference"]["passes"] = 60
    other = Results(results.params.model_validate(text), results.root)
    assert other.scenes == [] and BOX in other.unmeasured
    table = tables_of(other)["table_1"]
    told = "Not measured yet against 60 passes of SPPM: Cornell Box and Water Caustic."
    assert not table.rows and table.remarks[:2] == ("Not measured yet: Veach Ajar.", told)
    text["reference"]["target_psnr"] = 40.0  # fewer passes may be enough
    assert Results(results.params.model_validate(text), results.root).scenes == [BOX, WATER]


def test_rows_with_the_same_title_get_their_names(results):
    text = results.params.model_dump(mode="json")
    text["baselines"]["more"] = {"system": "sppm", "passes": 3, "photons_per_pass": 500_000}
    text["methods"]["classical"].append("more")
    titles = Results(results.params.model_validate(text), results.root).methods
    assert titles["sppm_3"] == "SPPM, 3 passes (sppm_3)" and titles["more"].endswith("(more)")
    assert len(set(titles.values())) == len(titles)


def test_table_2_says_why_it_is_empty(results):
    text = results.params.model_dump(mode="json")
    text["scenes"], text["ablations"] = [BOX], {}
    tables = tables_of(Results(results.params.model_validate(text), results.root))
    assert not tables["table_2"].rows
    why = "`baselines` has no such system for any measured scene."
    assert tables["table_2"].notes == [why]
    where = "Only for other scenes, according to `baselines`: "
    assert f"{where}3D Gaussian splatting, 3 views." in tables["table_1"].remarks


def test_the_papers_numbers_are_only_beside_the_same_methods(results):
    """The settings decide, not the name of a row."""
    text = results.params.model_dump(mode="json")
    rows = {"mine": text["baselines"]["path_10"], **text["baselines"]}
    rows["path_50"] = rows["path_50"] | {"spp": 49}
    text |= {"baselines": rows}
    params = results.params.model_validate(text)
    frame = tables_of(Results(params, results.root))["table_1"].frame.set_index("method")
    box = frame[frame["scene"] == "Cornell Box"]["psnr_paper"]
    assert box[[f"Path tracer, 10 spp ({m})" for m in ("mine", "path_10")]].tolist() == [30.49] * 2
    assert math.isnan(box["Path tracer, 49 spp"]) and box["SPPM, 3 passes"] == 30.47
    # The paper has references of 1000 passes, not of 30.
    time = tables_of(results)["table_4"].frame.set_index("method")
    assert time.loc["SPPM, 30 passes", f"{BOX}_paper"].isna().all()

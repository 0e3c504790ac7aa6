"""Tables are made from metric files, cost files and the paper's numbers, and of nothing else."""

from __future__ import annotations

import ast
import json
import math
import re
from itertools import combinations, count
from pathlib import Path
from statistics import fmean

import pandas as pd
import pytest
from pydantic import TypeAdapter
from ruamel.yaml import YAML

import report
from gpf.baselines.options import BaselineOptions
from report.paper import FILE
from report.results import NUMBERS, Results
from report.table import MISSING
from report.tables import make_tables, write_tables
from tests.report.made_up import BOX, WATER, edit, make_results

PACKAGE = Path(report.__file__).parent


@pytest.fixture
def results(tmp_path):
    return make_results(tmp_path / "results")


def tables_of(results: Results):
    """As a new process would make them: nothing that was read before is kept."""
    return {table.name: table for table in make_tables(Results(results.params, results.root))}


def leaves(data) -> list[float]:
    """Every number in a file."""
    if isinstance(data, dict):
        return [n for key, value in data.items() for n in [*leaves(key), *leaves(value)]]
    if isinstance(data, list):
        return [n for value in data for n in leaves(value)]
    is_number = isinstance(data, int | float) and not isinstance(data, bool)
    return [float(data)] if is_number else []


def cells(frame: pd.DataFrame) -> dict[tuple, float]:
    """(row, column) -> number."""
    return {
        (row, key): float(value)
        for key in frame.columns
        if not str(key).endswith("_rank")
        for row, value in enumerate(frame[key])
        if isinstance(value, int | float) and not math.isnan(value)
    }


def changes(before: pd.DataFrame, after: pd.DataFrame, *labels: str) -> set[tuple]:
    """The cells whose number is another, by their row's labels."""
    old, new = cells(before), cells(after)
    different = {place for place in old | new if old.get(place) != new.get(place)}
    return {(*(before.loc[row, label] for label in labels), key) for row, key in different}


def test_every_number_is_of_a_file(results):
    files = {path: json.loads(path.read_text()) for path in results.root.rglob("*.json")}
    known = {number for data in files.values() for number in leaves(data)}
    # What a table may make of them: means over scenes, time per view, per unit and per pass,
    # differences to the default. Extrapolations are marked, and tested elsewhere.
    for method in ("path_10", "path_50", "sppm_3", "gpf", "ceiling"):
        means = [
            files[results.root / s / "metrics" / f"{method}.json"]["mean"] for s in (BOX, WATER)
        ]
        known |= {fmean(mean[key] for mean in means) for key in NUMBERS}
    for folder in ("costs/baselines", "costs"):
        for path in results.root.glob(f"*/{folder}/*.json"):
            facts, parts = files[path]["facts"], files[path]["parts"]
            if "views" in facts:
                per_view = parts["render"]["wall_seconds"] / facts["views"]
                known |= {per_view, per_view / facts["path_seconds"]}
            if "seconds_per_single_view_pass" in facts:
                known |= {n * facts["seconds_per_single_view_pass"] for n in (1, 3, 10, 30)}
    for name, key in (("sppm_3", "storage_megabytes"), ("path_10", "storage_megabytes")):
        costs = [results.root / s / "costs" / "baselines" / f"{name}.json" for s in (BOX, WATER)]
        known.add(fmean(files[path]["facts"][key] for path in costs))
    costs = [results.root / s / "costs" / "render.json" for s in (BOX, WATER)]
    known.add(fmean(files[path]["facts"]["field_megabytes"] for path in costs))
    # And the references that a system learned from: 3 views, of 30 passes.
    per_pass = files[results.root / WATER / "costs" / "reference.json"]["facts"]
    fit = files[results.root / WATER / "costs" / "baselines" / "splatting_3.json"]["parts"]
    references = 3 * 30 * per_pass["seconds_per_shared_view_pass"]
    known.add(references + fit["prepare"]["wall_seconds"])
    default = files[results.root / WATER / "metrics" / "gpf.json"]["mean"]["psnr"]
    for path in (results.root / WATER / "ablations").iterdir():
        known.add(files[path]["mean"]["psnr"] - default)
    printed = leaves(YAML(typ="safe").load(FILE))
    papers = {*printed, *(fmean(pair) for pair in combinations(printed, 2))}

    counted = 0
    for name, table in tables_of(results).items():
        for (row, key), number in cells(table.frame).items():
            if key == "extrapolated_seconds":
                continue
            source = papers if key.endswith("_paper") else known
            assert any(math.isclose(number, n, rel_tol=1e-12) for n in source), (name, row, key)
            counted += 1
    assert counted > 300


def changed(data, factors):
    """The same with other numbers, each by a factor of its own."""
    if isinstance(data, dict):
        # References of other numbers of passes than params.yaml asks for would not be shown.
        return {k: v if k == "passes" else changed(v, factors) for k, v in data.items()}
    if isinstance(data, list):
        return [changed(value, factors) for value in data]
    return data * next(factors) if leaves(data) else data


def measured(results: Results) -> dict[tuple, float]:
    """(table, row, column) -> number, for all that is not the paper's."""
    return {
        (name, *place): number
        for name, table in tables_of(results).items()
        for place, number in cells(table.frame).items()
        if not place[1].endswith("_paper")
    }


def test_every_number_moves_with_a_file(results):
    before, moved = measured(results), set()
    for file in sorted(results.root.rglob("*.json")):
        text = file.read_text()
        factors = (1.1 + 0.01 * k for k in count())
        file.write_text(json.dumps(changed(json.loads(text), factors)))
        after = measured(results)
        moved |= {place for place in before | after if before.get(place) != after.get(place)}
        file.write_text(text)
    assert len(before) > 250
    # SPPM has nothing to prepare, whatever it takes.
    assert moved >= {place for place, number in before.items() if number}


def test_no_number_is_typed_in():
    """Programs hold no number that could be one of a table."""
    harmless = {0, 1, 2, 3, 4, 100.0, 1.05, 700.0}
    files = [PACKAGE / f"{name}.py" for name in ("table", "writing", "points", "paper", "results")]
    for file in [*files, *(PACKAGE / "tables").glob("*.py")]:
        nodes = ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        constants = {n.value for n in nodes if isinstance(n, ast.Constant)}
        typed = {c for c in constants if isinstance(c, int | float)} - harmless
        assert not typed, (file, typed)


def test_a_changed_file_changes_its_cells_and_no_others(results):
    before = tables_of(results)
    edit(results.root / BOX / "metrics" / "path_50.json", mean__ssim=0.4321)
    after = tables_of(results)
    found = changes(before["table_1"].frame, after["table_1"].frame, "scene", "method")
    path = "Path tracer, 50 spp"
    assert found == {("Cornell Box", path, "ssim"), ("Mean over 2 scenes", path, "ssim")}
    # And in the other tables nothing, or the same number.
    for name in set(before) - {"table_1"}:
        for _, key in changes(before[name].frame, after[name].frame):
            assert (name, key) == ("equal_time", "ssim")


def test_preparation_counts_what_is_learned_from(results):
    scene, passes = results.scene(BOX), 30
    path, splats, cache = (
        TypeAdapter(BaselineOptions).validate_python(row)
        for row in (
            {"system": "path_tracer"},
            {"system": "splatting", "views": 10},
            {"system": "radiance_cache"},
        )
    )
    file = results.root / BOX / "costs" / "reference.json"
    edit(file, facts__seconds_per_shared_view_pass=0.5)
    assert scene.inputs_seconds(path, passes) == 0
    assert scene.inputs_seconds(splats, passes) == 10 * 30 * 0.5
    assert scene.inputs_seconds(cache, passes) is None  # targets were not timed
    edit(file, facts__seconds_per_target_pass=0.25)
    edit(file, parts={"radius": {"wall_seconds": 7.0}, "points": {"wall_seconds": 5.0}})
    assert scene.inputs_seconds(cache, passes) == 30 * 0.25 + 7 + 5


def test_costs_come_from_cost_files(results):
    edit(results.root / WATER / "costs" / "render.json", parts__render__wall_seconds=80.0)
    edit(results.root / WATER / "costs" / "render.json", facts__path_seconds=0.05)
    tables = tables_of(results)
    time = tables["table_4"].frame.set_index(["quantity", "method"])
    ratio = next(group for group in tables["table_4"].groups if group.startswith("Times"))
    assert time.loc[("Seconds per image", "GPF, 16 spp"), WATER] == 20
    assert time.loc[("Seconds per image", "GPF, 16 spp"), f"{WATER}_paper"] == 16.34
    assert time.loc[(ratio, "GPF, 16 spp"), WATER] == pytest.approx(400)
    costs = tables["costs"].frame.set_index(["scene", "method"])
    assert costs.loc[("Water Caustic", "GPF, 16 spp"), "times_path"] == pytest.approx(400)


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
    # For people, each reason once, by a number.
    text = table.to_markdown()
    row = next(line for line in text.splitlines() if "RenderFormer" in line)
    number = re.search(r"RenderFormer<sup>(\d)</sup>", row)[1]
    assert f"{MISSING} (32.14)" in row
    assert text.count("glass and water are beyond it") == 1
    assert f"<sup>{number}</sup> glass and water are beyond it" in text
    assert "Not measured yet: Veach Ajar." in text


def test_what_nobody_asked_for_is_said(results):
    methods = {"classical": ["path_10"], "equal_time": [], "learned": []}
    params = results.params.model_validate(
        results.params.model_dump(mode="json") | {"methods": methods}
    )
    frame = tables_of(Results(params, results.root))["table_2"].frame
    row = frame[frame["method"] == "3D Gaussian splatting, 3 views"].iloc[0]
    assert math.isnan(row["psnr"]) and "`methods` in params.yaml does not list it" in row["reason"]


def test_no_cell_is_empty_without_a_reason(results):
    for table in make_tables(results):
        for row in range(len(table.rows)):
            whole = table.label_of(row)[1]
            for column in table.columns:
                text, _, why = table.cell(row, column)
                assert text != MISSING or whole or why, (table.name, row, column.key)


def test_means_are_over_scenes_and_the_papers_over_the_same(results):
    frame = tables_of(results)["table_1"].frame.set_index(["scene", "method"])
    for key in ("psnr", "ssim", "psnr_paper", "storage_mb_paper"):
        values = [
            frame.loc[(scene, "GPF, 16 spp"), key] for scene in ("Cornell Box", "Water Caustic")
        ]
        assert frame.loc[("Mean over 2 scenes", "GPF, 16 spp"), key] == pytest.approx(fmean(values))


def test_scenes_that_were_not_asked_for_have_no_row(results):
    frame = tables_of(results)["table_1"].frame
    learned = frame[frame["method"] == "3D Gaussian splatting, 3 views"]
    assert list(learned["scene"]) == ["Water Caustic"]
    glance = tables_of(results)["table_1_psnr"].frame
    assert list(glance.columns[:2]) == ["method", BOX] and len(glance) == 6


def test_the_ceiling_and_no_bytes_are_not_ranked(results):
    for scene in (BOX, WATER):
        edit(results.root / scene / "metrics" / "ceiling.json", mean__psnr=99.0)
    frame = tables_of(results)["table_1"].frame
    ceiling = frame[frame["method"] == "SPPM, 30 passes"]
    assert (ceiling["psnr"] == 99).all() and ceiling["psnr_rank"].isna().all()
    assert frame[frame["storage_mb"] == 0]["storage_mb_rank"].isna().all()
    for scene in ("Cornell Box", "Water Caustic"):
        ranked = frame[(frame["scene"] == scene) & frame["psnr_rank"].notna()]
        others = frame[(frame["scene"] == scene) & (frame["method"] != "SPPM, 30 passes")]
        assert (
            ranked.sort_values("psnr_rank")["psnr"].tolist()
            == sorted(others["psnr"].dropna(), reverse=True)[:2]
        )


def test_all_tables_are_written_in_four_ways(results, tmp_path):
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
    """Where LPIPS has no weights, say, it is missing in every table, for that reason."""
    why, alone = "LPIPS has no weights", "of this number of passes, PSNR alone was measured"
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


def test_references_of_other_lengths_are_not_compared(results):
    """After another profile was chosen, until its stages have run."""
    text = results.params.model_dump(mode="json")
    text["reference"]["passes"] = 60
    other = Results(results.params.model_validate(text), results.root)
    assert other.scenes == [] and BOX in other.unmeasured
    table = tables_of(other)["table_1"]
    told = "Not measured yet against 60 passes of SPPM: Cornell Box and Water Caustic."
    assert not table.rows and table.remarks[:2] == ("Not measured yet: Veach Ajar.", told)
    text["reference"]["target_psnr"] = 40.0  # fewer passes may have done
    assert Results(results.params.model_validate(text), results.root).scenes == [BOX, WATER]


def test_rows_of_one_title_are_told_apart(results):
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
    why = "`baselines` has no such system for a scene that has been measured."
    assert tables["table_2"].notes == [why]
    where = "Asked for in other scenes alone, by their rows of `baselines`: "
    assert f"{where}3D Gaussian splatting, 3 views." in tables["table_1"].remarks


def test_the_papers_numbers_stand_beside_the_same_methods_alone(results):
    """A row of another name is the same method; one with other settings is not."""
    text = results.params.model_dump(mode="json")
    rows = {"mine": text["baselines"]["path_10"], **text["baselines"]}
    rows["path_50"] = rows["path_50"] | {"spp": 49}
    text |= {"baselines": rows}
    params = results.params.model_validate(text)
    frame = tables_of(Results(params, results.root))["table_1"].frame.set_index("method")
    box = frame[frame["scene"] == "Cornell Box"]["psnr_paper"]
    assert box[[f"Path tracer, 10 spp ({m})" for m in ("mine", "path_10")]].tolist() == [30.49] * 2
    assert math.isnan(box["Path tracer, 49 spp"]) and box["SPPM, 3 passes"] == 30.47
    # References of 30 passes are not those of 1000.
    time = tables_of(results)["table_4"].frame.set_index("method")
    assert time.loc["SPPM, 30 passes", f"{BOX}_paper"].isna().all()

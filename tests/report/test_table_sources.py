"""All numbers in tables come from metric files, cost files and the paper."""

from __future__ import annotations

import ast
import json
import math
from itertools import combinations, count
from pathlib import Path
from statistics import fmean

import pandas as pd
import pytest
from pydantic import TypeAdapter
from ruamel.yaml import YAML

import report
from baselines.options import BaselineOptions
from report.paper import FILE
from report.results import NUMBERS, Results
from tests.report.made_up import BOX, WATER, cells, edit, make_results, seconds, tables_of

PACKAGE = Path(report.__file__).parent


@pytest.fixture
def results(tmp_path):
    return make_results(tmp_path / "results")


def leaves(data) -> list[float]:
    """All numbers in a file."""
    if isinstance(data, dict):
        return [n for key, value in data.items() for n in [*leaves(key), *leaves(value)]]
    if isinstance(data, list):
        return [n for value in data for n in leaves(value)]
    is_number = isinstance(data, int | float) and not isinstance(data, bool)
    return [float(data)] if is_number else []


def changes(before: pd.DataFrame, after: pd.DataFrame, *labels: str) -> set[tuple]:
    """Cells with different numbers, by their row's labels."""
    old, new = cells(before), cells(after)
    different = {place for place in old | new if old.get(place) != new.get(place)}
    return {(*(before.loc[row, label] for label in labels), key) for row, key in different}


def test_every_number_comes_from_a_file(results):
    files = {path: json.loads(path.read_text()) for path in results.root.rglob("*.json")}
    known = {number for data in files.values() for number in leaves(data)}
    # Numbers that tables may compute: means over scenes, times per view, per timing baseline and
    # per pass, differences from the default. Extrapolations are tested in test_points.py.
    for method in ("path_10", "path_50", "sppm_3", "gpf", "second_reference"):
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
    # The preparation includes the references that a system learns from: 3 views, 30 passes.
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
    """The same data with each number multiplied by another factor; counts stay whole."""
    if isinstance(data, dict):
        # With another number of passes than in params.yaml, the scene would not be shown.
        return {k: v if k == "passes" else changed(v, factors) for k, v in data.items()}
    if isinstance(data, list):
        return [changed(value, factors) for value in data]
    if not leaves(data):
        return data
    return 2 * data if isinstance(data, int) else data * next(factors)


def measured(results: Results) -> dict[tuple, float]:
    """(table, row, column) -> number, without the paper's numbers."""
    return {
        (name, *place): number
        for name, table in tables_of(results).items()
        for place, number in cells(table.frame).items()
        if not place[1].endswith("_paper")
    }


def test_every_number_changes_with_a_file(results):
    before, moved = measured(results), set()
    for file in sorted(results.root.rglob("*.json")):
        text = file.read_text()
        factors = (1.1 + 0.01 * k for k in count())
        file.write_text(json.dumps(changed(json.loads(text), factors)))
        after = measured(results)
        moved |= {place for place in before | after if before.get(place) != after.get(place)}
        file.write_text(text)
    assert len(before) > 250
    # The preparation of SPPM is always 0.
    assert moved >= {place for place, number in before.items() if number}


def test_no_number_is_typed_in():
    """The code has no number that could be one of a table."""
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
    # In other tables, only the same number changes.
    for name in set(before) - {"table_1"}:
        for _, key in changes(before[name].frame, after[name].frame):
            assert (name, key) == ("equal_time", "ssim")


def test_preparation_includes_the_training_data(results):
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
    edit(file, parts={"radius": seconds(7.0), "points": seconds(5.0)})
    assert scene.inputs_seconds(cache, passes) == 30 * 0.25 + 7 + 5


def test_costs_come_from_cost_files(results):
    edit(results.root / WATER / "costs" / "render.json", parts__render__wall_seconds=80.0)
    edit(results.root / WATER / "costs" / "render.json", facts__path_seconds=0.05)
    tables = tables_of(results)
    time = tables["table_4"].frame.set_index(["quantity", "method"])
    ratio = next(group for group in tables["table_4"].groups if group.startswith("In units of"))
    assert time.loc[("Seconds per image", "GPF, 16 spp"), WATER] == 20
    assert time.loc[("Seconds per image", "GPF, 16 spp"), f"{WATER}_paper"] == 16.34
    assert time.loc[(ratio, "GPF, 16 spp"), WATER] == pytest.approx(400)
    costs = tables["costs"].frame.set_index(["scene", "method"])
    assert costs.loc[("Water Caustic", "GPF, 16 spp"), "times_path"] == pytest.approx(400)

"""Equal time and equal quality: measured points and extrapolations."""

from __future__ import annotations

import math

import pytest

from gpf.core.files import write_json
from report.points import Point, extrapolate, measured_points
from report.results import Results
from report.tables.equal import equal_quality_table, equal_time_table
from report.writing import to_markdown
from tests.report.made_up import BOX, edit, make_results, seconds

COSTS = {"path_10": 8.0, "path_50": 40.0, "sppm_3": 400.0}
PSNR = {"path_10": 20.0, "path_50": 26.0, "sppm_3": 22.0, "gpf": 33.0}
CURVE = {1: 18.0, 3: 24.0, 10: 30.0, 30: 36.0}


@pytest.fixture
def results(tmp_path):
    """Results of the box, where a view takes the field 10 s, and a pass of SPPM takes 1 s."""
    results = make_results(tmp_path / "results", scenes=[BOX], ablations={})
    folder = results.root / BOX
    for method, psnr in PSNR.items():
        edit(folder / "metrics" / f"{method}.json", mean__psnr=psnr)
    for method, wall in COSTS.items():
        file = folder / "costs" / "baselines" / f"{method}.json"
        edit(file, parts__render__wall_seconds=wall)
    edit(folder / "costs" / "render.json", parts__render__wall_seconds=40.0)
    edit(folder / "costs" / "reference.json", facts__seconds_per_single_view_pass=1.0)
    rows = [{"passes": passes, "psnr": psnr} for passes, psnr in CURVE.items()]
    (folder / "convergence.json").write_text(str(rows).replace("'", '"'))
    return Results(results.params, results.root)


def test_points_are_in_the_order_of_time(results):
    points = measured_points(results, BOX)
    assert [(p.seconds, p.psnr) for p in points["path_tracer"]] == [(2, 20), (10, 26)]
    sppm = [(1, 18), (3, 24), (10, 30), (30, 36), (100, 22)]
    assert [(p.seconds, p.psnr) for p in points["sppm"]] == sppm
    assert points["renderformer"] == []


def test_at_equal_time_the_best_measured_setting(results):
    frame = equal_time_table(results).frame.set_index("method")
    assert frame["psnr"].dropna().to_dict() == {
        "Path tracer, 50 spp": 26,
        "SPPM, 10 passes as in references": 30,
        "GPF, 16 spp": 33,
    }
    assert math.isnan(frame.loc["SPPM, 10 passes as in references", "ssim"])
    assert "only PSNR" in frame.loc["SPPM, 10 passes as in references", "reason"]
    assert frame.loc["RenderFormer", "reason"] == "glass and water are beyond it"


def test_a_method_at_equal_time_is_a_point_of_its_system(results):
    """Its time is 1 % longer than the field's; the table allows this."""
    rows = results.params.model_dump(mode="json")
    rows["baselines"]["path_equal_time"] = {"system": "path_tracer", "spp": "equal_time"}
    rows["methods"]["equal_time"] = ["path_equal_time"]
    results = Results(results.params.model_validate(rows), results.root)
    folder = results.root / BOX
    write_json(folder / "metrics" / "path_equal_time.json", {"mean": {"psnr": 27.0}, "reasons": {}})
    cost = {"facts": {"views": 4}, "parts": {"render": seconds(40.4)}}
    write_json(folder / "costs" / "baselines" / "path_equal_time.json", cost)
    frame = equal_time_table(results).frame.set_index("method")
    assert frame.loc["Path tracer, equal time", "psnr"] == 27
    assert "Path tracer, 50 spp" not in frame.index
    needed = equal_quality_table(results).frame.set_index("system").loc["Path tracer"]
    assert needed["setting"] == "equal time" and needed["psnr"] == 27
    assert needed["extrapolated_seconds"] == pytest.approx(10.1 * (10.1 / 2) ** (6 / 7))


def test_a_system_whose_fastest_setting_is_slower(results):
    edit(results.root / BOX / "costs" / "render.json", parts__render__wall_seconds=2.0)
    frame = equal_time_table(Results(results.params, results.root)).frame.set_index("method")
    assert frame.loc["Path tracer", "reason"] == "its fastest setting takes 2.00 s per view"


def test_equal_quality_is_measured_or_not_reached(results):
    table = equal_quality_table(results)
    frame = table.frame.set_index("system")
    assert frame.loc["SPPM", "seconds_needed"] == 30 and frame.loc["SPPM", "psnr"] == 36
    assert frame.loc["SPPM", "setting"] == "30 passes as in references"
    assert frame.loc["Path tracer", "seconds_needed"] == "not reached in 10.0"
    assert frame.loc["GPF", ["seconds_needed", "seconds_needed_rank"]].tolist() == [10, 1]
    # 6 dB took 5 times the time, and 7 dB are missing.
    guess = frame.loc["Path tracer", "extrapolated_seconds"]
    assert guess == pytest.approx(10 * 5 ** (7 / 6))
    assert "| ≈ 65.4 |" in " ".join(to_markdown(table).split())
    assert "is not measured" in table.caption


def points(*pairs):
    return [Point("x", seconds, {"psnr": psnr}) for seconds, psnr in pairs]


@pytest.mark.parametrize(
    ("known", "seconds"),
    [
        (points((1, 20), (10, 30)), 10 * math.sqrt(10)),
        (points((1, 29), (2, 20), (20, 30)), 20 * math.sqrt(10)),
        # A point close to the last one is not used.
        (points((1, 20), (9, 30.5), (10, 30)), 10 * math.sqrt(10)),
        (points((9, 20), (10, 30)), None),
        (points((1, 20)), None),
        (points((1, 20), (10, 20)), None),
        (points((1, 20), (10, 20.5)), None),
    ],
)
def test_times_are_extrapolated_up_to_a_limit(known, seconds):
    """To 35 dB: log(seconds) is linear in dB between two points, up to a limit."""
    found = extrapolate(known, 35)
    assert found == (None if seconds is None else pytest.approx(seconds))


def test_without_the_field_there_is_nothing_to_equal(results):
    (results.root / BOX / "metrics" / "gpf.json").unlink()
    table = equal_quality_table(Results(results.params, results.root))
    assert not table.rows and "gpf stage render --scene cornell_box" in table.notes[0]

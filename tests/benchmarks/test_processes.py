"""`python -m benchmarks.processes`, at sizes of no use: each command runs, and prints numbers."""

import re

import drjit as dr
import pytest

from benchmarks import growth, start, viewer
from benchmarks.growth import QUANTITIES, Quantity, predict
from benchmarks.processes import app
from tests.benchmarks.conftest import cells, numbers

TINY = {
    "pixels": 16**2,
    "passes": 4,
    "photon paths": 1000,
    "Gaussians": 500,
    "photon paths in fog": 1000,
    "Gaussians in fog": 500,
    "triangles": 400,
    "lamps": 4,
    "views together": 2,
}


@pytest.mark.parametrize("name", TINY)
def test_each_quantity_has_something_to_measure(name):
    dr.eval(QUANTITIES[name].prepare(TINY[name])())


@pytest.mark.slow
def test_frames_of_a_film():
    done = QUANTITIES["frames"].prepare(2)()
    assert done.returncode == 0


def test_no_quantity_is_left_out():
    assert {*TINY, "frames"} == {*QUANTITIES}


@pytest.mark.parametrize(
    ("costs", "expected"),
    [([3, 5, 14], 104), ([9, 9, 9], 9), ([9, 8, 7], 7)],  # 14 + 9/90 900; a constant; noise
)
def test_a_line_predicts(costs, expected):
    assert predict((1, 10, 100), costs, 1000) == expected


@pytest.mark.slow
def test_growth(run, monkeypatch):
    small = Quantity(growth.light_lamps, (1, 4, 9), 16)
    monkeypatch.setitem(QUANTITIES, "lamps", small)
    large, *rest = cells(run(app, "growth", "lamps"), "lamps")
    assert large == "16" and min(numbers(rest[:1] + rest[5:6])) > 0 and len(rest) == 10


def test_memory(run):
    found, before = re.findall(r"(\d+) MB", run(app, "memory", "--rows", 16))
    assert int(found) >= int(before) > 50


@pytest.mark.slow
def test_start(run):
    steps = numbers(cells(run(app, "start", "cornell_box", "open_box"), "open_box"))
    assert len(steps) == len(start.STEPS) + 1
    assert steps[-1] == pytest.approx(sum(steps[:-1]), abs=0.2) and steps[-1] > 1


@pytest.mark.slow
def test_viewer(run, monkeypatch):
    small = {"ROWS": 64, "SPP": 4, "PASSES": 2, "WARM_UP": 1.0, "MEASURED": 2.0, "FITTED": 1.0}
    for name, value in small.items():
        monkeypatch.setattr(viewer, name, value)
    found = numbers(cells(run(app, "viewer", "cornell_box"), "cornell_box"))
    assert len(found) == 9 and found[0] > 0 and found[7] > 0.1  # pictures a second; GB

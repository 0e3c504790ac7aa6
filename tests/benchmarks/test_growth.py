"""What `python -m benchmarks.growth` measures, with sizes of no use."""

import drjit as dr
import pytest

from benchmarks.growth import QUANTITIES, predict

TINY = {
    "pixels": 16**2,
    "passes": 4,
    "photon paths": 1000,
    "Gaussians": 500,
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

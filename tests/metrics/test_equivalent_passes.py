"""Equivalent passes: at the measured points, between them, and outside the curve."""

import numpy as np
import pytest

from metrics.equivalent_passes import EquivalentPasses, equivalent_passes, snapshot_passes

CURVE = {3: 28.8, 30: 35.9, 100: 39.7, 1000: 45.2}


def test_a_measured_point_gives_its_own_number():
    for passes, psnr in CURVE.items():
        found = equivalent_passes(psnr, CURVE)
        assert found.bound == "" and found.passes == pytest.approx(passes)


def test_between_points_the_logarithm_is_linear():
    halfway = equivalent_passes((39.7 + 45.2) / 2, CURVE)
    assert halfway.passes == pytest.approx(np.sqrt(100 * 1000))
    assert str(halfway) == "316"
    assert str(equivalent_passes(29.5, CURVE)) == "3.8"


def test_outside_the_curve_the_result_is_a_bound():
    assert equivalent_passes(20.0, CURVE) == EquivalentPasses(3.0, "<")
    assert equivalent_passes(50.0, CURVE) == EquivalentPasses(1000.0, ">")
    assert [str(equivalent_passes(psnr, CURVE)) for psnr in (20.0, 50.0)] == ["<3", ">1000"]


def test_points_that_fall_are_left_out():
    # Any order; 20 passes are worse than 10, so that point is left out.
    curve = {40: 34.0, 10: 30.0, 20: 29.0}
    assert equivalent_passes(29.5, curve) == EquivalentPasses(10.0, "<")
    assert equivalent_passes(32.0, curve).passes == pytest.approx(20.0)
    assert equivalent_passes(34.5, {10: 30.0, 20: 34.0, 40: 33.0}) == EquivalentPasses(20.0, ">")


def test_bad_curves_are_errors():
    with pytest.raises(ValueError, match="curve has no point"):
        equivalent_passes(30.0, {})
    with pytest.raises(ValueError, match="needs passes >= 1 and finite"):
        equivalent_passes(30.0, {0: 20.0, 3: 25.0})
    with pytest.raises(ValueError, match="PSNR is nan"):
        equivalent_passes(float("nan"), CURVE)


def test_a_curve_has_two_points_per_power_of_ten_and_its_end():
    assert snapshot_passes(1) == [1]
    assert snapshot_passes(10) == [1, 3, 10]
    assert snapshot_passes(2000) == [1, 3, 10, 30, 100, 300, 1000, 2000]

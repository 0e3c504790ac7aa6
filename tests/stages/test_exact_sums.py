"""Sums without an order."""

from __future__ import annotations

from fractions import Fraction

import mitsuba as mi
import numpy as np
import pytest

from gpf.core.structs import from_numpy
from stages.references.pass_sums import ExactSum

NUMBERS = ("whole", "steps")


def terms(count: int, lanes: int, seed: int = 1) -> np.ndarray:
    """Of all sizes: from 1e-6 to 1e6, of both signs."""
    rng = np.random.default_rng(seed)
    size = 10 ** rng.uniform(-6, 6, (count, lanes, 3))
    return (size * rng.choice([-1, 1, 1], size.shape)).astype(np.float32)


def summed(values: np.ndarray) -> ExactSum:
    result = ExactSum(values.shape[1])
    for value in values:
        result.add(from_numpy(mi.Color3f, value))
    return result


def test_any_order_and_grouping_gives_the_same_bits():
    values = terms(60, 35)
    once = summed(values).total()
    backwards = summed(values[::-1]).total()
    np.testing.assert_array_equal(once, backwards)

    parts = summed(values[:7])
    parts.add_tensors(summed(values[23:]).tensors())
    parts.add_tensors(summed(values[7:23]).tensors())
    np.testing.assert_array_equal(once, parts.total())

    # What the same terms do as floats.
    assert (values.sum(0) != values[::-1].sum(0)).any()


def test_the_sum_is_right_to_the_last_step():
    values = terms(40, 5)
    found = summed(values).total()
    for lane in range(5):
        for channel in range(3):
            exact = float(sum(Fraction(float(v)) for v in values[:, lane, channel]))
            assert found[lane, channel] == pytest.approx(exact, rel=1e-14, abs=40 * 2.0**-40)


def test_a_long_sum_of_small_terms_does_not_stall():
    """A float32 that has reached 2^20 takes no notice of 1/64."""
    result = ExactSum(1)
    result.add(mi.Color3f(2.0**20))
    for _ in range(64):
        result.add(mi.Color3f(1 / 64))
    np.testing.assert_array_equal(result.total(), 2.0**20 + 1)


def test_a_fine_step_leaves_room_for_any_number_of_terms():
    """Eight terms of 2^60 steps are all that 64 bits hold."""
    result, other = ExactSum(1, bits=60), ExactSum(1, bits=60)
    for _ in range(32):
        result.add(mi.Color3f(0.75, -0.75, 0.25))
    other.add_tensors(result.tensors())
    other.add_tensors(result.tensors())
    np.testing.assert_array_equal(other.total(), [[48, -48, 16]])


@pytest.mark.parametrize("value", [np.inf, -np.inf, np.nan])
def test_what_is_not_finite_stays_so(value):
    result = ExactSum(2)
    result.add(mi.Color3f([0, 1], [value, 2], [0, 3]))
    result.add(mi.Color3f(1))
    np.testing.assert_array_equal(result.total(), [[np.nan] * 3, [2, 3, 4]])
    again = ExactSum(2)
    again.add_tensors(result.tensors())
    np.testing.assert_array_equal(again.total(), result.total())


def test_what_could_overflow_is_no_number():
    """A thousand terms of 2^52 fit into 64 bits; a larger one is refused."""
    result = ExactSum(2)
    result.add(mi.Color3f([2.0**51, 2.0**52], 0, 0))
    for _ in range(1000):
        result.add(mi.Color3f([2.0**51, 0], 0, 0))
    np.testing.assert_array_equal(result.total(), [[1001 * 2.0**51, 0, 0], [np.nan] * 3])


def test_it_survives_a_file():
    values = terms(3, 4)
    tensors = summed(values).tensors()
    assert all(tensors[k].dtype == np.int64 and tensors[k].shape == (4, 3) for k in NUMBERS)
    again = ExactSum(4)
    again.add_tensors(tensors)
    np.testing.assert_array_equal(again.total(), summed(values).total())

"""Random numbers of steps: none comes back."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.core.random import step_random


def step_numbers(seed: int, step: int) -> np.ndarray:
    numbers = (dr.opaque(mi.UInt32, n) for n in (seed, step))  # one kernel for all
    return step_random(2000, *numbers).next_float32().numpy()


def test_no_step_draws_what_another_one_did():
    numbers = np.array([step_numbers(1, step) for step in range(100)])
    assert numbers.mean() == pytest.approx(0.5, abs=0.003)
    # Random ones would fall on 1 - 1/e of 200000 places.
    places = np.unique((numbers * numbers.size).astype(int))
    assert len(places) == pytest.approx(126_424, abs=700)
    assert abs(np.corrcoef(numbers[3], numbers[4])[0, 1]) < 0.07
    assert abs(np.corrcoef(numbers[3, 1:], numbers[4, :-1])[0, 1]) < 0.07
    assert not np.array_equal(numbers[7], step_numbers(2, 7))
    np.testing.assert_array_equal(numbers[7], step_numbers(1, 7))

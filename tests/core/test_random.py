"""Sequences that lie evenly, each of whose elements is random."""

from __future__ import annotations

import numpy as np
import pytest

from gpf.core.random import random_start, spread_sample
from gpf.core.structs import to_numpy


def integral_errors(count: int) -> tuple[float, float]:
    """RMS error of the area of a quarter disc, by one lane's sequence and by random numbers."""
    inside = [
        (to_numpy(spread_sample(random_start(3, 4000), t)) ** 2).sum(axis=1) < 1
        for t in range(1, count + 1)
    ]
    area = np.mean(inside, axis=0)
    spread = np.sqrt(np.mean((area - np.pi / 4) ** 2))
    return spread, np.sqrt(np.pi / 4 * (1 - np.pi / 4) / count)


def test_every_element_is_uniform():
    for t in (1, 2, 1000, 10**6):
        sample = to_numpy(spread_sample(random_start(5, 100_000), t))
        assert sample.min() >= 0 and sample.max() < 1
        np.testing.assert_allclose(sample.mean(axis=0), 0.5, atol=0.005)
        np.testing.assert_allclose(np.var(sample, axis=0), 1 / 12, rtol=0.02)
        assert abs(np.corrcoef(sample.T)[0, 1]) < 0.02


@pytest.mark.parametrize("count", [16, 64, 256])
def test_a_lane_integrates_faster_than_random_numbers(count):
    """With N^(-3/4), as theory has it for a region with an edge, instead of N^(-1/2)."""
    spread, random = integral_errors(count)
    assert spread < 1.5 * count**-0.25 * random


def test_seeds_and_lanes_differ():
    a, b = (to_numpy(spread_sample(random_start(seed, 1000), 1)) for seed in (1, 2))
    assert np.abs(a - b).max() > 0.5
    assert len(np.unique(a, axis=0)) == 1000

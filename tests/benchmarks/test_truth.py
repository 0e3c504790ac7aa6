"""Errors against noisy images are those against images without noise."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.truth import Truth

SIZE = (1, 200, 200, 3)


def noisy(level: float, spread: float, seed: int) -> np.ndarray:
    """Parts of a truth, whose mean is ``level``."""
    rng = np.random.default_rng(seed)
    light = rng.gamma(1 / spread**2, level * spread**2, (1, 2, 2, 200, 200, 1))
    return (light * np.ones(3)).astype(np.float32)


@pytest.mark.parametrize(("level", "off"), [(0.1, 0), (0.5, 0), (0.9, 0), (0.1, 0.1), (0.5, 0.1)])
def test_noise_of_the_truth_is_no_error(level, off):
    image = np.full(SIZE, (1 + off) * level, np.float32)
    clear = Truth(np.full((1, 2, 200, 200, 3), level, np.float32), 1)
    expected = clear.errors(image).mean()
    truth = Truth.of_parts(noisy(level, 0.3, 0), 1)
    assert truth.errors(image).mean() == pytest.approx(expected, abs=1.5e-4)


def test_without_parts_it_would_be():
    image = np.full(SIZE, 0.9, np.float32)
    whole = Truth.of_parts(noisy(0.9, 0.6, 0), 1)
    errors = [truth.errors(image).mean() for truth in (whole, Truth(whole.halves, 1))]
    assert abs(errors[0]) < errors[1] / 3

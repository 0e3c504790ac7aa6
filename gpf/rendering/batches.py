"""Images with more samples than fit into memory, rendered in batches."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from gpf.core.random import Stream, pass_seed

LARGEST_WAVEFRONT = 1 << 26
"""Largest number of samples in one batch: about 2 GB of state."""


def mean_of_batches(
    render: Callable[[int, int], np.ndarray],
    spp: int,
    seed: int,
    pixels: int,
    largest: int = LARGEST_WAVEFRONT,
) -> np.ndarray:
    """The mean of batches with independent samples: at most ``largest``, but at least one per
    pixel, (H, W, C) float32.

    Parameters
    ----------
    render: called as ``render(spp, seed)``; returns an image.
    """
    total: Any = 0
    for batch, share in enumerate(split_samples(spp, pixels, largest)):
        image = render(share, pass_seed(seed, batch, Stream.BATCHES))
        total = total + np.asarray(image, dtype=np.float64) * (share / spp)
    return np.asarray(total, dtype=np.float32)


def split_samples(spp: int, pixels: int, largest: int) -> list[int]:
    """Samples per pixel of each batch; they differ by at most one."""
    most = max(largest // pixels, 1)
    batches = -(-spp // most)
    return [(spp * (k + 1)) // batches - (spp * k) // batches for k in range(batches)]

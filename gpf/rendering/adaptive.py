"""Camera samples where they are needed: pixels that a few samples leave noisy get more of them.

Most of an image is known after a few samples per pixel: the field has no noise. What is left is in
few pixels, behind glass and along edges. A pilot of half of the samples finds them; the rest is
given to pixels in proportion to their noise (Neyman's allocation), in sets as large as the pilot's,
so that all samples are one kernel's. Within a set they are as evenly spread as the sampler can,
which is why sets are large: a fine texture is worth more of that than of the allocation.

How many sets a pixel gets is decided by the pilot's samples in the pixels *around* it, never by
its own. A pixel whose pilot missed something bright would otherwise get few more samples, one that
found it many, and the mean over all of them would be too dark. What is left of that is a pixel's
share in the noise of the whole image, by which all numbers are scaled.

The samples of a set are kept apart in blocks of a few, which tells fireflies from what is bright
(:mod:`gpf.rendering.fireflies`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.ndimage import convolve

from gpf.camera.rays import TILE
from gpf.core.random import Stream, pass_seed
from gpf.rendering.fireflies import BrightestBlocks, choose_block

LEAST_SPP = 16
"""With fewer samples per pixel, a pilot tells too little."""

# Samples of one launch, of which each is kept for a moment.
LARGEST_LAUNCH = 1 << 23

# A pixel gets at most so many times the samples that pixels have on average.
MOST = 16

# Pixels around one whose samples tell of its noise: a square of so many, without its centre.
AROUND = 5

Samples = Callable[["mi.Sampler", "mi.Vector2u"], "list[mi.Float]"]
"""From a seeded sampler and the pixel of each lane to the channels of each lane's sample, of which
the first three are its radiance."""


def sample_adaptively(
    sample: Samples,
    sampler: mi.Sampler,
    size: tuple[int, int],
    spp: int,
    seed: int,
    suppress_fireflies: bool = False,
) -> mi.TensorXf:
    """Means of all channels of an image, (H, W, C); up to ``spp`` samples per pixel on average.

    Parameters
    ----------
    sampler: whose kind of samples is taken.
    size: width and height, pixels.
    spp: not below :data:`LEAST_SPP`.
    suppress_fireflies: whether single samples of great radiance count less, which has a bias
        (:mod:`gpf.rendering.fireflies`).
    """
    width, height = size
    order = tile_order(width, height)
    sampler = sampler.fork()
    in_set = _choose_set(sampler, spp)
    brightest = BrightestBlocks(size) if suppress_fireflies else None
    taker = _SetTaker(sample, sampler, size, in_set, brightest)
    sums, squares = taker.take(order, pass_seed(seed, 0, Stream.ADAPTIVE_SAMPLES))
    noise = pixel_noise(sums[:, :3] / in_set, squares / in_set, (height, width))
    sets = allocate(noise, max(spp // in_set - 1, 0))
    again = np.repeat(order, sets[order])
    if len(again):
        sums += taker.take(again, pass_seed(seed, 1, Stream.ADAPTIVE_SAMPLES))[0]
    if brightest is not None:
        sums[:, :3] -= brightest.excess()
    means = sums / (in_set * (1 + sets))[:, None]
    return mi.TensorXf(means.astype(np.float32).reshape(height, width, -1))


def _choose_set(sampler: mi.Sampler, spp: int) -> int:
    """How many samples a set has, which the sampler divides evenly in both dimensions.

    No more than half of all, and the largest of which whole multiples leave no more than a
    sixteenth of the samples unused. The sampler may make another number of it.
    """
    sizes = [n for n in range(4, spp // 2 + 1) if _is_even(sampler, n)]
    sampler.set_sample_count(max(n for n in sizes if n == 4 or 16 * (spp % n) <= spp))
    return int(sampler.sample_count())


def _is_even(sampler: mi.Sampler, n: int) -> bool:
    """Whether a sampler has grids of ``n`` cells: most have squares alone."""
    side = math.isqrt(n)
    match sampler.class_name():
        case "MultijitterSampler":
            return n % side == 0
        case "LowDiscrepancySampler":
            return n == side * side and side.bit_count() == 1
        case _:
            return n == side * side


def tile_order(width: int, height: int) -> np.ndarray:
    """Numbers of all pixels, such that those of a small square follow each other, (H W,)."""
    y, x = (i.ravel() for i in np.indices((height, width)))
    return np.lexsort((x % TILE, y % TILE, x // TILE, y // TILE))


@dataclass(frozen=True)
class _SetTaker:
    """Takes sets of ``in_set`` samples in pixels of an image of a width and height, ``size``.

    Where ``brightest`` is given, it is told of all blocks.
    """

    sample: Samples
    sampler: mi.Sampler
    size: tuple[int, int]
    in_set: int
    brightest: BrightestBlocks | None

    def take(self, pixels: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
        """A set in each of some pixels, which may come more than once.

        Returns sums over the samples of all pixels, (N, C), and of their squared radiance, (N,).
        """
        total: Any = 0
        step = max(LARGEST_LAUNCH // self.in_set, 1)
        for number, start in enumerate(range(0, len(pixels), step)):
            part = pixels[start : start + step]
            total = total + self._launch(part, pass_seed(seed, number, Stream.ADAPTIVE_SAMPLES))
        return total[:, :-1], total[:, -1]

    def _launch(self, pixels: np.ndarray, seed: int) -> np.ndarray:
        """What fits into one launch; the sum of the squared radiance is the last column."""
        lanes = len(pixels) * self.in_set
        sampler = self.sampler.fork()
        sampler.set_sample_count(self.in_set)
        sampler.set_samples_per_wavefront(self.in_set)
        sampler.seed(seed, lanes)
        place = dr.arange(mi.UInt32, lanes) // dr.opaque(mi.UInt32, self.in_set)
        number = dr.gather(mi.UInt32, mi.UInt32(pixels.astype(np.uint32)), place)
        width = dr.opaque(mi.UInt32, self.size[0])
        row = number // width
        channels = self.sample(sampler, mi.Vector2u(number - row * width, row))
        square = sum((c * c for c in channels[:3]), mi.Float(0)) / 3
        each = dr.zeros(mi.Float, lanes)  # a channel may be the same for all lanes
        values = [value + each for value in (*channels, square)]
        dr.eval(values)  # each sum is a kernel of its own, and would trace them anew
        block = choose_block(self.in_set)
        blocks = [dr.block_sum(value, block) for value in values]
        if self.brightest is not None:
            self.brightest.add(pixels, mi.Color3f(blocks[:3]))
        count, in_row = self.size[0] * self.size[1], self.in_set // block
        # In double precision, of the very blocks of which some are taken away again.
        rows = [values.numpy().astype(np.float64).reshape(-1, in_row) for values in blocks]
        sums = [np.bincount(pixels, row @ np.ones(in_row), count) for row in rows]
        return np.stack(sums, axis=1)


def pixel_noise(mean: np.ndarray, square: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Standard deviation of one sample of each pixel as it shows on a display, (N,).

        σ² = (⟨L²⟩ - ⟨L⟩²) / ((⟨L⟩ + m/100) (1 + (⟨L⟩/4m)²)),

    the mean over the pixels around each, m the median of the image: a display shows the square
    root of what is dim, and nothing of what is far brighter than the rest.
    """
    level = mean.mean(axis=1)
    level = np.where(np.isfinite(level), np.maximum(level, 0), 0)
    lit = level[level > 0]
    median = float(np.median(lit)) if len(lit) else 1.0
    variance = np.maximum(square - (mean**2).mean(axis=1), 0)
    # What is not finite is for the caller to find in the image.
    variance[~np.isfinite(variance)] = 0
    visible = variance / ((level + 0.01 * median) * (1 + (level / (4 * median)) ** 2))
    ring = np.ones((AROUND, AROUND))
    ring[AROUND // 2, AROUND // 2] = 0
    # Nothing is made up beyond the border: it would come from the pixel itself.
    total, count = (
        convolve(grid, ring, mode="constant") for grid in (visible.reshape(shape), np.ones(shape))
    )
    return np.asarray(np.sqrt(total / np.maximum(count, 1)).ravel())


def allocate(noise: np.ndarray, mean: int) -> np.ndarray:
    """Numbers of sets in proportion to the noise, rounded, (N,).

    Their mean comes as close to ``mean`` from below as numbers that are all scaled alike can.
    """
    if mean == 0 or not noise.any():
        return np.full(len(noise), mean)
    noise = noise / noise.mean()
    low, high = 0.0, 1e6 * mean
    for _ in range(100):
        scale = 0.5 * (low + high)
        low, high = (scale, high) if _rounded(noise, scale, mean).mean() <= mean else (low, scale)
    return _rounded(noise, low, mean)


def _rounded(noise: np.ndarray, scale: float, mean: int) -> np.ndarray:
    return np.minimum(np.rint(scale * noise), MOST * mean).astype(np.int64)

"""Adaptive sampling: noisy pixels get more camera samples, others fewer.

Beside the levels of detail, of which it takes one at random near their borders, the field has no
noise, so most pixels are exact after a few samples. Noise remains in a few pixels,
behind glass and along edges. A pilot with half of the samples finds these pixels; the other half is
distributed in proportion to the noise (Neyman's allocation). Samples are taken in sets as large as
the pilot's, so that one kernel serves all of them. The sampler spreads the samples of a set evenly
over the pixel. Sets are large because fine textures gain more from that than from the allocation.

The number of sets of a pixel depends on the pilot's samples in the pixels *around* it, never on its
own. Otherwise a pixel whose pilot missed something bright would get few further samples and one
whose pilot found it would get many, which would make the mean too dark. A small dependence remains:
the allocation is scaled by the noise of the whole image, which includes the pixel's own.

The samples of a set are summed in small blocks, which tell fireflies from really bright pixels
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
from gpf.core.structs import from_numpy
from gpf.rendering.fireflies import BrightestBlocks, choose_block_size

MIN_SPP = 16
"""With fewer samples per pixel, the pilot is too small."""

# Largest number of samples in one launch; all of them are in memory for a moment.
LARGEST_LAUNCH = 1 << 21

# Largest number of further sets of a pixel, in units of the mean over all pixels.
MAX_RATIO = 16

# A pixel's noise is estimated from a square of this many pixels a side, without its centre.
NEIGHBOURHOOD = 5

SampleFunction = Callable[["mi.Sampler", "mi.Vector2u"], "list[mi.Float]"]
"""From a seeded sampler and the pixel of each lane to the channels of each lane's sample; the first
three channels are the radiance."""


def sample_adaptively(
    sample: SampleFunction,
    sampler: mi.Sampler,
    size: tuple[int, int],
    spp: int,
    seed: int,
    suppress_fireflies: bool = False,
    with_variance: bool = False,
) -> mi.TensorXf:
    """Means of all channels of an image, (H, W, C), from at most ``spp`` samples per pixel on
    average.

    Parameters
    ----------
    sampler: a fork of it draws the samples.
    size: width and height, pixels.
    spp: at least :data:`MIN_SPP`.
    suppress_fireflies: whether single samples of great radiance count less; this has a bias
        (:mod:`gpf.rendering.fireflies`).
    with_variance: whether another channel follows: the variance of each pixel's mean radiance, as
        far as the sets around it differ (:func:`variance_of_means`).
    """
    width, height = size
    order = tile_order(width, height)
    sampler = sampler.fork()
    set_size = _choose_set_size(sampler, spp)
    brightest = BrightestBlocks(size) if suppress_fireflies else None
    sets = _Sets(sample, sampler, size, set_size, brightest)
    sums, squares, of_sets = sets.take(order, pass_seed(seed, 0, Stream.ADAPTIVE_SAMPLES))
    noise = pixel_noise(sums[:, :3] / set_size, squares / set_size, (height, width))
    counts = allocate(noise, max(spp // set_size - 1, 0))
    again = np.repeat(order, counts[order])
    if len(again):
        further, _, of_further = sets.take(again, pass_seed(seed, 1, Stream.ADAPTIVE_SAMPLES))
        sums, of_sets = sums + further, of_sets + of_further
    scatter = of_sets - (sums[:, :3] ** 2).mean(axis=1) / (1 + counts)
    if brightest is not None:
        sums[:, :3] -= brightest.excess()
    means = sums / (set_size * (1 + counts))[:, None]
    if with_variance:
        variance = variance_of_means(scatter / set_size**2, counts, (height, width))
        means = np.column_stack([means, variance])
    return from_numpy(mi.TensorXf, means.reshape(height, width, -1))


def _choose_set_size(sampler: mi.Sampler, spp: int) -> int:
    """The number of samples in a set, of which the sampler can make an even grid.

    At most half of all samples, and the largest whose multiples leave at most a sixteenth of the
    samples unused. Mitsuba's sampler may round it.
    """
    sizes = [n for n in range(4, spp // 2 + 1) if _has_grid(sampler, n)]
    sampler.set_sample_count(max(n for n in sizes if n == 4 or 16 * (spp % n) <= spp))
    return int(sampler.sample_count())


def _has_grid(sampler: mi.Sampler, n: int) -> bool:
    """Whether a sampler has grids of ``n`` cells; most samplers have square grids only."""
    side = math.isqrt(n)
    match sampler.class_name():
        case "MultijitterSampler":
            return n % side == 0
        case "LowDiscrepancySampler":
            return n == side * side and side.bit_count() == 1
        case _:
            return n == side * side


def tile_order(width: int, height: int) -> np.ndarray:
    """Numbers of all pixels, (H W,), sorted so that the pixels of a small square are together."""
    y, x = (i.ravel() for i in np.indices((height, width)))
    return np.lexsort((x % TILE, y % TILE, x // TILE, y // TILE))


@dataclass(frozen=True)
class _Sets:
    """Takes sets of samples, and adds their blocks to ``brightest`` if it is given."""

    sample: SampleFunction
    sampler: mi.Sampler
    size: tuple[int, int]
    set_size: int
    brightest: BrightestBlocks | None

    def take(self, pixels: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Take one set for each entry of ``pixels``, in which a pixel may occur several times.

        Returns, for all N pixels of the image, the sums of the samples, (N, C), the sums of their
        squared radiance, (N,), and the sums of the squared sums of sets, (N,).
        """
        total: Any = 0
        step = max(LARGEST_LAUNCH // self.set_size, 1)
        for number, start in enumerate(range(0, len(pixels), step)):
            part = pixels[start : start + step]
            total = total + self._launch(part, pass_seed(seed, number, Stream.ADAPTIVE_SAMPLES))
        return total[:, :-2], total[:, -2], total[:, -1]

    def _launch(self, pixels: np.ndarray, seed: int) -> np.ndarray:
        """One launch: what :meth:`take` returns, in the columns of an array, (N, C + 2)."""
        lanes = len(pixels) * self.set_size
        sampler = self.sampler.fork()
        sampler.set_sample_count(self.set_size)
        sampler.set_samples_per_wavefront(self.set_size)
        sampler.seed(seed, lanes)
        place = dr.arange(mi.UInt32, lanes) // dr.opaque(mi.UInt32, self.set_size)
        number = dr.gather(mi.UInt32, from_numpy(mi.UInt32, pixels), place)
        width = dr.opaque(mi.UInt32, self.size[0])
        row = number // width
        channels = self.sample(sampler, mi.Vector2u(number - row * width, row))
        square = sum((c * c for c in channels[:3]), mi.Float(0)) / 3
        each = dr.zeros(mi.Float, lanes)  # a channel may hold a single value for all lanes
        values = [value + each for value in (*channels, square)]
        dr.eval(values)  # otherwise the kernel of each sum would trace them again
        block_size = choose_block_size(self.set_size)
        blocks = [dr.block_sum(value, block_size) for value in values]
        if self.brightest is not None:
            self.brightest.add(pixels, mi.Color3f(blocks[:3]))
        count, in_row = self.size[0] * self.size[1], self.set_size // block_size
        # Double-precision sums of these same blocks, because `excess` subtracts some of them later.
        rows = [values.numpy().astype(np.float64).reshape(-1, in_row) for values in blocks]
        of_sets = [row @ np.ones(in_row) for row in rows]
        of_sets.append(sum(values**2 for values in of_sets[:3]) / 3)
        return np.stack([np.bincount(pixels, values, count) for values in of_sets], axis=1)


def least_visible(level: np.ndarray) -> np.ndarray:
    """The squared error of a radiance ``level`` that is about as visible everywhere, as of the
    equation of :func:`pixel_noise`: (L + m/100) (1 + (L/4m)²); any shape."""
    level = np.where(np.isfinite(level), np.maximum(level, 0), 0)
    lit = level[level > 0]
    median = float(np.median(lit)) if len(lit) else 1.0
    visible: np.ndarray = (level + 0.01 * median) * (1 + (level / (4 * median)) ** 2)
    return visible


def variance_of_means(
    scatter: np.ndarray, counts: np.ndarray, shape: tuple[int, int]
) -> np.ndarray:
    """Variance of each pixel's mean, (N,), from how much the sets differ in the pixels around it.

    Pixels with a single set tell nothing; where all around are such, it is zero, because only
    pixels without noise get no further sets.

    Parameters
    ----------
    scatter: sum over a pixel's sets of (mean of the set - mean of the pixel)², (N,).
    counts: number of further sets, (N,).
    shape: height and width of the image.
    """
    window = np.ones((NEIGHBOURHOOD, NEIGHBOURHOOD))
    total, free = (
        convolve(grid.reshape(shape).astype(float), window, mode="constant").ravel()
        for grid in (np.maximum(scatter, 0), counts)
    )
    return np.asarray(total / np.maximum(free, 1) / (1 + counts))


def pixel_noise(mean: np.ndarray, square: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Standard deviation of one sample of each pixel, as visible on a display, (N,).

        σ² = (⟨L²⟩ - ⟨L⟩²) / ((⟨L⟩ + m/100) (1 + (⟨L⟩/4m)²)),

    averaged over the pixels around each; m is the median of the image. A display shows about the
    square root of dim radiance, and saturates far above the median.

    Parameters
    ----------
    mean: mean radiance of the pilot's samples, (N, 3).
    square: mean squared radiance of the pilot's samples, (N,).
    shape: height and width of the image.
    """
    variance = np.maximum(square - (mean**2).mean(axis=1), 0)
    # Values that are not finite also show in the image, where the caller finds them.
    variance[~np.isfinite(variance)] = 0
    visible = variance / least_visible(mean.mean(axis=1))
    ring = np.ones((NEIGHBOURHOOD, NEIGHBOURHOOD))
    ring[NEIGHBOURHOOD // 2, NEIGHBOURHOOD // 2] = 0
    # No padding at the border, because its values would come from the pixel itself.
    total, count = (
        convolve(grid, ring, mode="constant") for grid in (visible.reshape(shape), np.ones(shape))
    )
    return np.asarray(np.sqrt(total / np.maximum(count, 1)).ravel())


def allocate(noise: np.ndarray, mean: int) -> np.ndarray:
    """Numbers of further sets in proportion to the noise, rounded, (N,).

    A common scale makes their mean as large as possible without exceeding ``mean``.
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
    return np.minimum(np.rint(scale * noise), MAX_RATIO * mean).astype(np.int64)

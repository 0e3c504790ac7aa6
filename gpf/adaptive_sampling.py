"""Camera samples where they are needed: pixels that a few samples leave noisy get more of them.

Most of an image is known after a few samples per pixel: the field has no noise. What is left is in
few pixels, behind glass and along edges. A pilot of a quarter of the samples finds them; the rest
is given to pixels in proportion to their noise (Neyman's allocation).

How many samples a pixel gets is decided by the pilot's samples in the pixels *around* it, never by
its own. A pixel whose pilot missed something bright would otherwise get few more samples, one that
found it many, and the mean over all of them would be too dark. So it has no bias.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.ndimage import convolve

from gpf.camera_rays import TILE
from gpf.progressive import pass_seed

# One launch each: squares, which samplers divide evenly in both dimensions.
COUNTS = (0, 4, 9, 16, 36, 64, 144, 256, 576, 1024)
LEAST_SPP = 16
"""With fewer samples per pixel, a pilot tells too little."""

# Of the random numbers of pixels.
STREAM = 12

# Pixels around one whose samples tell of its noise: a square of so many, without its centre.
AROUND = 5

Samples = Callable[[mi.Sampler, mi.Vector2u], list[mi.Float]]
"""From a seeded sampler and the pixel of each lane to the channels of each lane's sample, of which
the first three are its radiance."""


def sample_adaptively(
    sample: Samples, sampler: mi.Sampler, size: tuple[int, int], spp: int, seed: int
) -> mi.TensorXf:
    """Means of all channels of an image, (H, W, C), with ``spp`` samples per pixel on average.

    Parameters
    ----------
    sampler: copies of which are set to the numbers of samples that are needed.
    size: width and height, pixels.
    """
    width, height = size
    order = tile_order(width, height)
    pilot = int(math.sqrt(spp / 4)) ** 2
    sums, squares = _sample_pixels(sample, sampler, order, width, pilot, pass_seed(seed, 0, STREAM))
    flat = np.empty_like(sums)
    flat[order] = sums
    second = np.empty_like(squares)
    second[order] = squares
    noise = pixel_noise(flat[:, :3] / pilot, second / pilot, (height, width))
    counts = allocate(noise, spp - pilot)
    for number, count in enumerate(COUNTS):
        chosen = order[counts[order] == count]
        if count and len(chosen):
            again = pass_seed(seed, number, STREAM)
            more, _ = _sample_pixels(sample, sampler, chosen, width, count, again)
            flat[chosen] += more
    means = flat / (pilot + counts)[:, None]
    return mi.TensorXf(means.astype(np.float32).reshape(height, width, -1))


def tile_order(width: int, height: int) -> np.ndarray:
    """Numbers of all pixels, such that those of a small square follow each other, (H W,)."""
    y, x = (i.ravel() for i in np.indices((height, width)))
    return np.lexsort((x % TILE, y % TILE, x // TILE, y // TILE))


def _sample_pixels(
    sample: Samples, sampler: mi.Sampler, pixels: np.ndarray, width: int, count: int, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """Sums over ``count`` samples of each pixel, (N, C), and of their squared radiance, (N,)."""
    sampler = sampler.fork()
    sampler.set_sample_count(count)
    sampler.set_samples_per_wavefront(count)
    sampler.seed(seed, len(pixels) * count)
    lane = dr.arange(mi.UInt32, len(pixels) * count) // dr.opaque(mi.UInt32, count)
    number = dr.gather(mi.UInt32, mi.UInt32(pixels.astype(np.uint32)), lane)
    row = number // dr.opaque(mi.UInt32, width)
    channels = sample(sampler, mi.Vector2u(number - row * dr.opaque(mi.UInt32, width), row))
    square = sum((c * c for c in channels[:3]), mi.Float(0)) / 3
    each = dr.zeros(mi.Float, len(pixels) * count)  # a channel may be the same for all lanes
    sums = [dr.block_sum(value + each, count) for value in (*channels, square)]
    dr.eval(sums)
    table = np.stack([np.asarray(s.numpy(), dtype=np.float64) for s in sums], axis=1)
    return table[:, :-1], table[:, -1]


def pixel_noise(mean: np.ndarray, square: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Standard deviation of one sample of each pixel as it shows on a display, (N,).

        σ² = (⟨L²⟩ - ⟨L⟩²) / ((⟨L⟩ + m/100) (1 + (⟨L⟩/4m)²)),

    the mean over the pixels around each, m the median of the image: a display shows the square
    root of what is dim, and nothing of what is far brighter than the rest.
    """
    level = mean.mean(axis=1)
    lit = level[level > 0]
    median = float(np.median(lit)) if len(lit) else 1.0
    variance = np.maximum(square - (mean**2).mean(axis=1), 0)
    visible = variance / ((level + 0.01 * median) * (1 + (level / (4 * median)) ** 2))
    ring = np.ones((AROUND, AROUND))
    ring[AROUND // 2, AROUND // 2] = 0
    # Nothing is made up beyond the border: it would come from the pixel itself.
    total, count = (
        convolve(grid, ring, mode="constant") for grid in (visible.reshape(shape), np.ones(shape))
    )
    return np.asarray(np.sqrt(total / np.maximum(count, 1)).ravel())


def allocate(noise: np.ndarray, mean: float) -> np.ndarray:
    """Numbers of samples, out of :data:`COUNTS`, in proportion to the noise, (N,).

    Their mean comes as close to ``mean`` from below as numbers that are all scaled alike can.
    """
    if not noise.any():
        noise = np.ones_like(noise)
    counts = np.array(COUNTS)
    # Between two numbers, what is beyond their geometric mean goes up.
    bounds = np.sqrt(np.maximum(counts[:-1], 1) * counts[1:])
    low, high = 0.0, counts[-1] / max(float(np.mean(noise)), 1e-300) * 1e6
    for _ in range(100):
        scale = 0.5 * (low + high)
        chosen = counts[np.searchsorted(bounds, scale * noise)]
        low, high = (scale, high) if chosen.mean() <= mean else (low, scale)
    return np.asarray(counts[np.searchsorted(bounds, low * noise)])

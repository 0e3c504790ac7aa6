"""Adaptive sampling: noisy pixels get more camera samples, others fewer.

Except near the borders between levels of detail, where it picks one at random, the field has no
noise, so most pixels are exact after a few samples. Noise remains in a few pixels, behind glass and
along edges. A pilot with half of the samples finds these pixels; the other half is distributed in
proportion to the noise (Neyman allocation). Samples are taken in sets as large as the pilot's, so
that one kernel serves all of them. The sampler spreads the samples of a set evenly over the pixel.
Sets are large because fine textures gain more from that than from the allocation.

The number of sets of a pixel depends on the pilot's samples in the pixels *around* it, never on its
own. Otherwise a pixel whose pilot missed something bright would get few further samples and one
whose pilot found it would get many, which would make the mean too dark. A small dependence remains:
the allocation is scaled by the noise of the whole image, which includes the pixel's own.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi

from gpf.core.random import Stream, pass_seed
from gpf.rendering.fireflies import BrightestBlocks, neighbours
from gpf.rendering.sample_sets import SampleFunction, SampleSets

MIN_SPP = 16
"""With fewer samples per pixel, the pilot is too small."""

# Largest number of further sets of a pixel, in units of the mean over all pixels.
MAX_RATIO = 16

# A pixel's noise is estimated from a square of this many pixels a side, without its centre.
NEIGHBOURHOOD = 5


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
    suppress_fireflies: whether single samples of very high radiance count less, which introduces
        a bias (:mod:`gpf.rendering.fireflies`).
    with_variance: whether to append a channel with the variance of each pixel's mean radiance, as
        estimated from differences between the sets around it (:func:`variance_of_means`).
    """
    sampler = sampler.fork()
    set_size = _choose_set_size(sampler, spp)
    brightest = BrightestBlocks(size) if suppress_fireflies else None
    sets = SampleSets(sample, sampler, size, set_size, brightest)
    one = dr.full(mi.UInt32, 1, size[0] * size[1])
    sums = sets.take(one, pass_seed(seed, 0, Stream.ADAPTIVE_SAMPLES))
    *channels, square, of_sets = sums
    noise = pixel_noise([c / set_size for c in channels[:3]], square / set_size, size)
    counts = allocate(noise, max(spp // set_size - 1, 0), one_in_each_neighbourhood(size))
    if further := sets.take(counts, pass_seed(seed, 1, Stream.ADAPTIVE_SAMPLES)):
        *channels, _, of_sets = (a + b for a, b in zip(sums, further, strict=True))
    taken = 1 + mi.Float64(counts)
    scatter = of_sets - _mean_square(channels) / taken
    if brightest is not None:
        channels[:3] = [c - e for c, e in zip(channels[:3], brightest.excess(), strict=True)]
    means = [c / (set_size * taken) for c in channels]
    if with_variance:
        means.append(variance_of_means(scatter / set_size**2, counts, means[:3], size))
    flat = dr.ravel(mi.ArrayXf([mi.Float(mean) for mean in means]))
    return mi.TensorXf(flat, (size[1], size[0], len(means)))


def _choose_set_size(sampler: mi.Sampler, spp: int) -> int:
    """The number of samples in a set, which the sampler can arrange in an even grid.

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


def least_visible(level: Any, median: float) -> Any:
    """The squared error that is about equally visible at any radiance ``level``, as in
    :func:`pixel_noise`: (L + m/100) (1 + (L/4m)²), with the median m of the image.

    ``level`` is an array of numpy or Dr.Jit without negative values.
    """
    return (level + 0.01 * median) * (1 + (level / (4 * median)) ** 2)


def variance_of_means(
    scatter: mi.Float64, counts: mi.UInt32, mean: Sequence[mi.Float64], size: tuple[int, int]
) -> mi.Float64:
    """Variance of each pixel's mean, (N,), from how much the sets differ in the pixels around it.

    Pixels with a single set tell nothing, but one in each neighbourhood has more
    (:func:`one_in_each_neighbourhood`). What counts is the visible noise of the pixels around:
    that of a lamp's edge is not the noise of the wall behind it.

    Parameters
    ----------
    scatter: sum over a pixel's sets of (mean of the set - mean of the pixel)², (N,).
    counts: number of further sets, (N,).
    mean: mean radiance, (N,) for each of three channels.
    size: width and height of the image.
    """
    scale = _visible_squares(mean)
    visible = dr.maximum(scatter, 0) / scale
    total, free = _sums_around([visible, mi.Float64(counts)], size, itself=True)
    return total * scale / dr.maximum(free, 1) / (1 + mi.Float64(counts))


def pixel_noise(
    mean: Sequence[mi.Float64], square: mi.Float64, size: tuple[int, int]
) -> mi.Float64:
    """Standard deviation of one sample of each pixel, as visible on a display, (N,).

        σ² = (⟨L²⟩ - ⟨L⟩²) / ((⟨L⟩ + m/100) (1 + (⟨L⟩/4m)²)),

    averaged over the pixels around each; m is the median of the image. A display shows about the
    square root of dim radiance, and saturates far above the median.

    Parameters
    ----------
    mean: mean radiance of the pilot's samples, (N,) for each of three channels.
    square: mean squared radiance of the pilot's samples, (N,).
    size: width and height of the image.
    """
    variance = dr.maximum(square - _mean_square(mean), 0)
    # Values that are not finite also show in the image, where the caller finds them.
    visible = dr.select(dr.isfinite(variance), variance, 0) / _visible_squares(mean)
    # No padding at the border, because its values would come from the pixel itself.
    total, count = _sums_around([visible, dr.full(mi.Float64, 1, dr.width(visible))], size)
    return dr.sqrt(total / dr.maximum(count, 1))


def _visible_squares(mean: Sequence[mi.Float64]) -> mi.Float64:
    """:func:`least_visible` for each pixel of an image, (N,), from its three channels."""
    level = sum(mean[1:3], mean[0]) / 3
    level = dr.select(dr.isfinite(level), dr.maximum(level, 0), 0)
    lit = dr.compress(level > 0)
    median = float(dr.median(dr.gather(mi.Float64, level, lit))[0]) if dr.width(lit) else 1.0
    return least_visible(level, dr.opaque(mi.Float64, median))


def _mean_square(channels: Sequence[mi.Float64]) -> mi.Float64:
    """Mean of the squares of the first three channels."""
    red, green, blue = channels[:3]
    return (red * red + green * green + blue * blue) / 3


def _sums_around(
    grids: list[mi.Float64], size: tuple[int, int], itself: bool = False
) -> list[mi.Float64]:
    """Sums of each grid over the :data:`NEIGHBOURHOOD` of each pixel, with or without the pixel."""
    dr.eval(grids)
    pixel = dr.arange(mi.UInt32, size[0] * size[1])
    sums = [mi.Float64(0) for _ in grids]
    for there, inside in neighbours(size, NEIGHBOURHOOD // 2):
        counts = inside & ((there != pixel) | itself)
        values = [dr.gather(mi.Float64, grid, there, counts) for grid in grids]
        sums = [a + b for a, b in zip(sums, values, strict=True)]
    dr.eval(sums)
    return sums


def one_in_each_neighbourhood(size: tuple[int, int]) -> mi.UInt32:
    """1 for a pixel of each :data:`NEIGHBOURHOOD`, 0 for the others, (N,).

    These have at least one further set, so that the variance is known everywhere, also where
    others need the samples more.
    """
    width, height = (dr.opaque(mi.UInt32, n) for n in size)
    pixel = dr.arange(mi.UInt32, size[0] * size[1])
    places = (pixel % width, width), (pixel // width, height)
    # At the end, a neighbourhood may have no middle.
    chosen = [(n % NEIGHBOURHOOD == NEIGHBOURHOOD // 2) | (n == end - 1) for n, end in places]
    return mi.UInt32(chosen[0] & chosen[1])


def allocate(noise: mi.Float64, mean: int, least: mi.UInt32) -> mi.UInt32:
    """Numbers of further sets in proportion to the noise, rounded, (N,).

    A common scale makes their mean as large as possible without exceeding ``mean``; ``least``, (N,)
    with a smaller mean, is given in any case.
    """
    pixels = dr.width(noise)
    whole = float(dr.sum(noise)[0])
    if mean == 0 or whole == 0:
        return dr.full(mi.UInt32, mean, pixels)
    noise = noise * dr.opaque(mi.Float64, pixels / whole)
    dr.eval(noise)

    def rounded(scale: float) -> mi.UInt32:
        wanted = dr.round(dr.opaque(mi.Float64, scale) * noise)
        return dr.maximum(mi.UInt32(dr.minimum(wanted, MAX_RATIO * mean)), least)

    low, high = 0.0, 1e6 * mean
    while high - low > 1e-6 * high:
        scale = 0.5 * (low + high)
        enough = int(dr.sum(rounded(scale))[0]) <= mean * pixels
        low, high = (scale, high) if enough else (low, scale)
    return rounded(low)

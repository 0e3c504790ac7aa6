"""Guided samples of the emitters, aimed at where direct light comes from.

Behind a window, most samples of a sky hit the wall; with many lamps, most are in other rooms. A
sample of the emitters is determined by two uniform random numbers, whatever emitters there are. In
each cell of space, a pilot shows from which parts of this unit square light arrives. The square is
divided into B bins; bin b has the probability

    P_b = UNIFORM / B + (1 - UNIFORM) sqrt(m_b) / Σ sqrt(m),

the numbers are uniform in it, and the light of a sample is divided by B P_b, so that the mean is
unchanged. m_b is the mean square of the light that arrives with numbers in the bin.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.structs import from_numpy
from gpf.guiding.density_control import cell_keys

SIDE = 16
"""Number of bins along each side of the unit square."""

UNIFORM = 0.15
"""Fraction of the samples that are not guided, so that every sample remains possible."""

POINTS_PER_CELL = 300
"""Cells of space are widened until they hold about this many points."""

# This many samples with the mean square of the whole scene are added to those in a bin of a cell.
_PRIOR = 1.0

# Standard deviation, in bins, of the weights of neighbouring bins, which count as well. Without
# them, samples are few and bright where a pilot has missed light: behind a window, with four
# samples at each point, seven times as much noise remains.
_SMOOTHING = 0.6


class LampGuide:
    """Densities over the unit square, one in each cell of space.

    Parameters
    ----------
    cell: index of each point's cell, (N,).
    square: sum of the squared light of the samples in each bin of each cell, (C, SIDE, SIDE).
    count: number of these samples, (C, SIDE, SIDE).
    """

    def __init__(self, cell: np.ndarray, square: np.ndarray, count: np.ndarray) -> None:
        from scipy.ndimage import gaussian_filter  # slow to import

        spread = 0, _SMOOTHING, _SMOOTHING
        square, count = (gaussian_filter(v.astype(float), spread) for v in (square, count))
        everywhere = square.sum(axis=0) / np.maximum(count.sum(axis=0), 1e-9)
        mean = (square + _PRIOR * everywhere) / (count + _PRIOR)
        root = np.sqrt(mean)
        total = root.sum(axis=(1, 2), keepdims=True)
        # Where nothing is known to arrive, all numbers are equally likely.
        share = np.where(total > 0, root / np.maximum(total, 1e-300), 1 / SIDE**2)
        self.chance = UNIFORM / SIDE**2 + (1 - UNIFORM) * share
        # Noise with the guide over noise without it; sqrt(m) gives the least possible variance.
        weight = count.sum(axis=(1, 2))
        with_guide = (mean / self.chance).sum(axis=(1, 2)) / SIDE**4
        without = mean.sum(axis=(1, 2)) / SIDE**2
        self.remaining = float((weight * with_guide).sum() / max((weight * without).sum(), 1e-300))
        column = self.chance.sum(axis=2)
        self._columns = _cumulated(column)
        self._rows = _cumulated(self.chance / column[:, :, None])
        self._cell = from_numpy(mi.UInt32, cell.astype(np.uint32))

    def warp(self, sample: mi.Point2f) -> tuple[mi.Point2f, mi.Float]:
        """Guided random numbers for each point, (N, 2), from uniform ones, and the factors by which
        to multiply their light, (N,)."""
        x, column, wide = _invert(self._columns, self._cell, sample.x)
        y, _, high = _invert(self._rows, self._cell * SIDE + column, sample.y)
        return mi.Point2f(x, y), 1 / (wide * high * SIDE**2)


def find_cells(p: np.ndarray, n: np.ndarray) -> np.ndarray:
    """The index of the cell of each oriented point (N, 3), (N,)."""
    extent = float(np.linalg.norm(p.max(axis=0) - p.min(axis=0)))
    width = max(extent / 64, 1e-6)
    while True:
        known, cell = np.unique(cell_keys(p, n, width), return_inverse=True)
        if len(known) * POINTS_PER_CELL <= len(p) or width > extent:
            return np.asarray(cell.ravel())
        width *= 1.25


def count_bins(
    cell: np.ndarray, sample: np.ndarray, light: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """``square`` and ``count`` of :class:`LampGuide`, from one sample of each point.

    Parameters
    ----------
    cell: index of each point's cell, (N,).
    sample: uniform random numbers in [0, 1)², (N, 2).
    light: light that arrives with these numbers, (N,).
    """
    place = np.minimum((sample * SIDE).astype(np.int64), SIDE - 1)
    index = (cell * SIDE + place[:, 0]) * SIDE + place[:, 1]
    shape = (int(cell.max()) + 1, SIDE, SIDE)
    size = int(np.prod(shape))
    square = np.bincount(index, light.astype(float) ** 2, size)
    return square.reshape(shape), np.bincount(index, minlength=size).reshape(shape)


def _cumulated(chance: np.ndarray) -> mi.Float:
    """Cumulative probabilities along the last axis, flat; the last of each row is 1."""
    cumulated = np.cumsum(chance, axis=-1)
    cumulated /= cumulated[..., -1:]
    return from_numpy(mi.Float, cumulated.astype(np.float32).ravel())


def _invert(
    cumulated: mi.Float, row: mi.UInt32, u: mi.Float
) -> tuple[mi.Float, mi.UInt32, mi.Float]:
    """Numbers in [0, 1) with the density of a row, (N,), their bins, and the bins' probabilities.

    Parameters
    ----------
    cumulated: cumulative probabilities of the bins of all rows, flat.
    u: uniform random numbers, (N,).
    """
    first, bin_ = row * SIDE, mi.UInt32(0)
    step = SIDE // 2
    while step:
        below = dr.gather(mi.Float, cumulated, first + bin_ + (step - 1)) <= u
        bin_ = dr.select(below, bin_ + step, bin_)
        step //= 2
    high = dr.gather(mi.Float, cumulated, first + bin_)
    low = dr.select(bin_ > 0, dr.gather(mi.Float, cumulated, first + bin_ - 1, bin_ > 0), 0)
    chance = high - low
    place = (mi.Float(bin_) + (u - low) / chance) / SIDE
    return dr.clip(place, 0, dr.one_minus_epsilon(mi.Float)), bin_, chance

"""Density control: Russian roulette on photons where there are more than needed."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.random import Stream, pass_seed
from gpf.core.structs import Photons, VisiblePoints, from_numpy, take, to_numpy

# The share of all photons that a cell keeps is at most this multiple of its share of all visible
# points: a caustic needs more Gaussians than the wall around it; the inside of a lamp does not.
MAX_RATIO = 8.0

_MOST_NUMBERS = 2**62

HEIGHTS = 4
"""Number of layers of a cell, which separate surfaces that lie above each other."""


def control_density(
    photons: Photons, points: Photons | VisiblePoints, width: float, seed: int
) -> Photons:
    """The photons that survive Russian roulette in cells with few visible points.

    A photon survives with probability ``min(1, MAX_RATIO s_points / s_photons)``, where
    s_points and s_photons are the shares of all visible points and of all photons that lie in its
    cell. Its power is divided by the probability, so that sums over an area are unbiased. Surfaces
    with different orientations have different cells: the outside of a lamp has few photons and
    keeps them.

    Parameters
    ----------
    points: visible points of cameras, (L,).
    width: edge length of the cells, world units.
    """
    p = oriented_places(to_numpy(photons.p), to_numpy(photons.n), width)
    seen = oriented_places(to_numpy(points.p), to_numpy(points.n), width)
    photon, point = count_in_cells(p, width, p, seen)
    ratio = (point / len(seen)) / (photon / len(p))
    # A cell without visible points counts as if it had half a point.
    least = 0.5 / len(seen) * len(p) / photon
    survival = np.minimum(1, MAX_RATIO * np.maximum(ratio, least))
    rng = np.random.default_rng(pass_seed(seed, 0, Stream.DENSITY_CONTROL))
    lives = np.flatnonzero(rng.random(len(p)) < survival)
    kept = take(photons, from_numpy(mi.UInt32, lives))
    kept.power /= from_numpy(mi.Float, survival[lives])
    dr.eval(kept)
    return kept


def oriented_places(p: np.ndarray, n: np.ndarray, width: float) -> np.ndarray:
    """Positions, the nearest axis of their normals, and their height along the normal above
    the middle of their cell, (N, 5).

    A grid with cells of ``width`` then separates surfaces with different orientations, and those
    that lie above each other, such as a lamp's back and the cap behind it. On a plane, all points
    of a cell have the same height.

    Parameters
    ----------
    p, n: positions and normals, (N, 3).
    """
    axis = np.abs(n).argmax(axis=1)
    side = np.take_along_axis(n, axis[:, None], axis=1)[:, 0] > 0
    middle = (np.floor(p / width) + 0.5) * width
    height = np.einsum("ni,ni->n", n, p - middle)
    return np.column_stack([p, (2 * axis + side + 0.5) * width, HEIGHTS * height])


def cell_keys(p: np.ndarray, n: np.ndarray, width: float) -> np.ndarray:
    """A number for the grid cell of each oriented point, (N,); see :func:`oriented_places`."""
    return _number_cells(oriented_places(p, n, width), width)


def count_in_cells(at: np.ndarray, width: float, *sets: np.ndarray) -> list[np.ndarray]:
    """The number of points of each set (N, D) in the grid cell of each point of ``at`` (M, D)."""
    keys = _number_cells(np.concatenate([at, *sets]), width)
    known, index = np.unique(keys, return_inverse=True)
    wanted, *found = np.split(index, np.cumsum([len(at), *map(len, sets[:-1])]))
    return [np.bincount(each, minlength=len(known))[wanted] for each in found]


def _number_cells(p: np.ndarray, width: float) -> np.ndarray:
    """A number for the grid cell of each point (N, D), (N,), in the order of the cells."""
    cells = np.floor(p / width).astype(np.int64)
    numbers, count = np.zeros(len(p), np.int64), 1
    for column in (cells - cells.min(axis=0)).T:
        size = int(column.max()) + 1
        if count * size > _MOST_NUMBERS:  # a horizon far away: leave out the cells without points
            numbers = np.unique(numbers, return_inverse=True)[1]
            count = int(numbers.max()) + 1
        numbers, count = numbers * size + column, count * size
    return numbers

"""The cubes in which photons are summed: larger where a field cannot be fine."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.structs import from_numpy

LEVEL_BITS = 2
"""Bits that hold a level."""

# The coarsest level: its edges are half the radius of a wide kernel after 100 passes.
_COARSEST = 2

# The table of levels: edge of its cells, in edges of the finest cubes, and their maximum number.
_WIDTH = 16
_MOST_CELLS = 1 << 22

# Largest index of a cube along an axis; it has 16 bits.
_LARGEST_NUMBER = 65535

# A cube's edge is at most this share of the distance between the points around it.
_SHARE = 0.5


class PhotonCells:
    """Cubes of several sizes: at level l, edges are 2^l times as long as at level 0.

    Each place has a level. It is 0 where the points that gather photons are dense. Where they are
    far apart, as on the walls of a large room with cameras around a table in its middle, the finest
    cubes would hold single photons, more than fit into memory, for detail that the points cannot
    resolve.

    Parameters
    ----------
    edge: edge of the finest cubes, world units; longer if the scene spans more than 65535 of them.
    bounds: corners of the box that is divided.
    points: points that gather photons, world units, (N, 3); without them, every level is 0.
    dimensions: 2 if the points lie on surfaces, 3 if they lie in space.

    Attributes
    ----------
    bounds: the same corners.
    """

    def __init__(
        self,
        edge: float,
        bounds: tuple[Any, Any],
        points: np.ndarray | None = None,
        dimensions: int = 2,
    ) -> None:
        self.bounds = bounds
        lower, upper = (np.array([float(corner[k]) for k in range(3)]) for corner in bounds)
        edge = max(edge, float(np.max(upper - lower)) / _LARGEST_NUMBER)
        self._edge = dr.opaque(mi.Float, edge)
        self._lower = mi.Point3f(*(dr.opaque(mi.Float, float(x)) for x in lower))
        table, width = np.zeros((1, 1, 1), np.uint32), float(np.max(upper - lower)) + edge
        if points is not None:
            table, width = _choose_levels(points, dimensions, edge, lower, upper - lower)
        self._levels = from_numpy(mi.UInt32, table.ravel())
        self._inverse = dr.opaque(mi.Float, 1 / width)
        self._last = mi.Vector3i(*(dr.opaque(mi.Int32, n - 1) for n in table.shape))
        _, y, z = table.shape
        self._stride = mi.Vector3u(dr.opaque(mi.UInt32, y * z), dr.opaque(mi.UInt32, z), 1)
        dr.make_opaque(self._levels)

    def find(self, p: mi.Point3f) -> tuple[mi.UInt32, mi.Vector3u, mi.Vector3f]:
        """The levels of the cubes in which points (N, 3) lie, the cubes' indices along each axis,
        at most 65535, and the positions within them, [0, 1)."""
        at = mi.Vector3i(dr.floor((p - self._lower) * self._inverse))
        level = dr.gather(
            mi.UInt32, self._levels, dr.dot(mi.Vector3u(dr.clip(at, 0, self._last)), self._stride)
        )
        offset = (p - self._lower) / (self._edge * mi.Float(mi.UInt32(1) << level))
        corner = dr.clip(dr.floor(offset), 0, _LARGEST_NUMBER)
        return level, mi.Vector3u(corner), mi.Vector3f(offset - corner)

    def points(self, level: mi.UInt32, corner: mi.Vector3u, inside: mi.Vector3f) -> mi.Point3f:
        """Points from the results of :meth:`find`, (N, 3)."""
        edge = self._edge * mi.Float(mi.UInt32(1) << level)
        return mi.Point3f(self._lower + edge * (mi.Vector3f(corner) + inside))


def _choose_levels(
    points: np.ndarray, dimensions: int, edge: float, lower: np.ndarray, extent: np.ndarray
) -> tuple[np.ndarray, float]:
    """The table of levels, (X, Y, Z), and the edge of its cells."""
    from scipy.ndimage import minimum_filter  # slow to import

    width = _WIDTH * edge
    while np.prod(np.floor(extent / width) + 1) > _MOST_CELLS:
        width *= 1.1
    shape = tuple(int(n) for n in np.floor(extent / width) + 1)
    cell = np.clip(np.floor((points - lower) / width).astype(np.int64), 0, np.array(shape) - 1)
    count = np.bincount(np.ravel_multi_index(cell.T, shape), minlength=math.prod(shape))
    # Assumes one surface in the cell; with more, the points are farther apart than this.
    distance = width / np.maximum(count, 1e-6) ** (1 / dimensions)
    level = np.clip(np.floor(np.log2(_SHARE * distance / edge)), 0, _COARSEST)
    # Points also gather photons from the cells around their own.
    table: np.ndarray = minimum_filter(level.reshape(shape), 3).astype(np.uint32)
    return table, width

"""A coarse grid that knows which way nearby surfaces face."""

from __future__ import annotations

from itertools import product
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.recordable import Recordable

# Largest number of cells in the table; in larger grids, several cells share an entry.
LARGEST_TABLE = 1 << 20

# A direction is mapped to the nearest of 26 directions: axes, and diagonals of two or three axes.
# The result is at most 35.3° away. A normal within 45.6° of the direction (gpf.core.surface_tags,
# including the rounding of tags) is therefore at most 81.5° from that result.
_COMPATIBLE = 0.147


class FacingCells(Recordable):
    """For each cell of a grid, the directions of the normals in the cell or its neighbours.

    A search for oriented points within ``reach`` can be skipped where :meth:`may_contain` is
    false. On the unlit back of a wall, it would visit all points of the lit side in vain.

    Parameters
    ----------
    p, n: points and unit normals, (N, 3).
    reach: edge length of a cell, world units.
    bounds: two opposite corners of a box around the points.
    """

    READ = ("_lower", "_inverse", "_last", "_stride", "_mask", "_directions")

    def __init__(self, p: mi.Point3f, n: mi.Normal3f, reach: float, bounds: tuple[Any, Any]):
        lower = [float(bounds[0][i]) for i in range(3)]
        size = [max(1, int((float(bounds[1][i]) - lower[i]) / reach) + 1) for i in range(3)]
        table = 1 << (min(size[0] * size[1] * size[2], LARGEST_TABLE) - 1).bit_length()
        # Opaque, so that kernels are compiled once for all grids.
        self._lower = mi.Point3f(*(dr.opaque(mi.Float, v) for v in lower))
        self._inverse = dr.opaque(mi.Float, 1 / reach)
        self._last = mi.Vector3i(*(dr.opaque(mi.Int32, s - 1) for s in size))
        self._stride = mi.Vector3u(
            1, dr.opaque(mi.UInt32, size[0]), dr.opaque(mi.UInt32, size[0] * size[1] & 0xFFFFFFFF)
        )
        self._mask = dr.opaque(mi.UInt32, table - 1)
        self._directions = dr.zeros(mi.UInt32, table)
        self._add(p, _directions_near(n))
        dr.eval(self._directions)

    def may_contain(self, x: mi.Point3f, n: mi.Normal3f, active: mi.Bool) -> mi.Bool:
        """False where no point within ``reach`` of ``x`` has a normal within 45° of ``n``, (N,)."""
        near = dr.gather(mi.UInt32, self._directions, self._entry(self._cell(x)), active)
        return active & ((near >> _direction(n)) & 1 != 0)

    @dr.syntax
    def _add(self, p: mi.Point3f, directions: mi.UInt32) -> None:
        """Add the directions to the cell of each point and to the 26 cells around it."""
        cell = self._cell(p)
        k = mi.Int32(0)
        while k < 27:
            other = cell + mi.Vector3i(k % 3 - 1, k // 3 % 3 - 1, k // 9 - 1)
            inside = dr.all((other >= 0) & (other <= self._last))
            dr.scatter_reduce(
                dr.ReduceOp.Or, self._directions, directions, self._entry(other), inside
            )
            k += 1

    def _cell(self, p: mi.Point3f) -> mi.Vector3i:
        # Points outside the bounds belong to the outermost cells.
        last = mi.Vector3f(self._last)
        return mi.Vector3i(dr.clip((p - self._lower) * self._inverse, 0, last))

    def _entry(self, cell: mi.Vector3i) -> mi.UInt32:
        return dr.dot(mi.Vector3u(cell), self._stride) & self._mask


def _direction(n: mi.Normal3f) -> mi.UInt32:
    """The number of the nearest of the 26 directions: 0 to 26, except 13."""
    whole = mi.Vector3i(dr.round(n / dr.max(dr.abs(n)))) + 1
    return mi.UInt32(whole.x + 3 * whole.y + 9 * whole.z)


def _directions_near(n: mi.Normal3f) -> mi.UInt32:
    """Bit mask of the directions whose queries accept a point with the normal ``n``."""
    found = mi.UInt32(0)
    for z, y, x in product((-1, 0, 1), repeat=3):
        axis = np.array([x, y, z], dtype=float)
        if axis.any():
            axis /= np.linalg.norm(axis)
            bit = 1 << (x + 1 + 3 * (y + 1) + 9 * (z + 1))
            found |= dr.select(
                dr.dot(n, mi.Vector3f(axis.tolist())) > _COMPATIBLE, mi.UInt32(bit), 0
            )
    return found

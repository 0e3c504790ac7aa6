"""The grids of a neighbour search, each with cells four times as large as the last."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from gpf.core.recordable import Recordable
from gpf.core.structs import concatenate

# Ratio of the edge lengths of the cells of two consecutive levels.
_RATIO = 4


@dataclass
class Grid:
    """Constants of a level: the cell of a point, and the cell's bucket in the tables; (L,) for a
    number of levels.

    The table of each level follows that of the level before. If a grid has many more cells than
    points, rows of cells share buckets.
    """

    inv_cell: mi.Float
    last: mi.Vector3f
    stride: mi.Vector2u
    mask: mi.UInt32
    first_bucket: mi.UInt32

    def row(self, y: mi.Int32, z: mi.Int32) -> mi.UInt32:
        """The first bucket of a row of cells, (N,)."""
        index = mi.UInt32(y) * self.stride.x + mi.UInt32(z) * self.stride.y
        return (index & self.mask) + self.first_bucket


class GridLevels(Recordable):
    """Grids over the same box.

    Parameters
    ----------
    cell: edge length of a cell of the first level, world units.
    bounds: two opposite corners of the box.
    size: number of points to be sorted.
    far: whether there are further levels, up to one whose cells are as large as the box.

    Attributes
    ----------
    extent: the larger of the diagonal of the bounds and ``cell``, world units.
    slack: what rounding may add to a distance, world units.
    wraps: whether rows of cells share buckets.
    first: the first level.
    """

    READ = ("slack", "first", "_lower", "_cell", "_grids", "_last")

    def __init__(self, cell: float, bounds: tuple[Any, Any], size: int, far: bool) -> None:
        lower = [float(bounds[0][i]) for i in range(3)]
        edges = [float(bounds[1][i]) - lower[i] for i in range(3)]
        self.extent = max(math.hypot(*edges), cell)
        count = 1
        while far and cell * _RATIO ** (count - 1) < self.extent:
            count += 1
        self.wraps = False
        self._buckets: list[int] = []
        self._plans = [self._plan(cell * _RATIO**level, edges, size) for level in range(count)]
        # Values that change from build to build are opaque, so that kernels are compiled once.
        self._lower = mi.Point3f(*(dr.opaque(mi.Float, v) for v in lower))
        self.slack = dr.opaque(mi.Float, 1e-6 * self.extent)
        self._cell = dr.opaque(mi.Float, cell)
        self.first, self._grids = _grid(self._plans[:1]), _grid(self._plans)
        self._last = dr.opaque(mi.UInt32, count - 1)

    def _plan(self, cell: float, edges: list[float], size: int) -> tuple[float, ...]:
        """The constants of the next level."""
        x, y, z = (max(1, int(e / cell) + 1) for e in edges)
        # A power of two, so that a bit mask maps a row's index into the table.
        table = 1 << (min(x * y * z, max(4 * size, 1 << 20)) - 1).bit_length()
        self.wraps |= x * y * z > table
        first = sum(self._buckets)
        # The last row needs x more buckets, and its last one an end. The number is rounded up to a
        # power of two, because each table size needs its own kernel.
        self._buckets.append(table + (1 << (x + 1).bit_length()))
        # The product may exceed 32 bits; only the bits that the mask keeps matter.
        return 1 / cell, x - 1, y - 1, z - 1, x, x * y & 0xFFFFFFFF, table - 1, first

    def sort(self, points: mi.Point3f) -> tuple[mi.UInt32, mi.UInt32]:
        """The order of the points by bucket, level by level, and the start of each bucket."""
        orders, starts = [], []
        for number, (plan, buckets) in enumerate(zip(self._plans, self._buckets, strict=True)):
            grid = _grid([plan])
            c = self.cell_of(grid, points)
            bucket = grid.row(c.y, c.z) - grid.first_bucket + mi.UInt32(c.x)
            counts = dr.zeros(mi.UInt32, buckets)
            dr.scatter_add(counts, mi.UInt32(1), bucket)
            start = dr.prefix_reduce(dr.ReduceOp.Add, counts, exclusive=True)
            orders.append(dr.argsort(bucket))
            starts.append(start + dr.opaque(mi.UInt32, number * dr.width(points)))
        return concatenate(orders), concatenate(starts)

    def cell_of(self, grid: Grid, p: mi.Point3f) -> mi.Vector3i:
        """The cells of points at a level, (N, 3). Points outside the bounds belong to the outermost
        cells; queries stay exact, because clipping is monotone."""
        return mi.Vector3i(dr.clip((p - self._lower) * grid.inv_cell, 0, grid.last))

    def fit(self, radius: mi.Float, active: mi.Bool) -> Grid:
        """The first level whose cells are at least half as large as the radius, (N,)."""
        steps = dr.ceil(dr.log2(0.5 * radius / self._cell) / math.log2(_RATIO))
        level = dr.minimum(mi.UInt32(dr.maximum(steps, 0)), self._last)
        return dr.gather(Grid, self._grids, level, active)


def _grid(plans: list[tuple[float, ...]]) -> Grid:
    """The constants of levels, opaque."""
    types = (mi.Float,) * 4 + (mi.UInt32,) * 4
    inverse, *last, y, z, mask, first = (
        kind(list(values)) if len(values) > 1 else dr.opaque(kind, values[0])
        for kind, *values in zip(types, *plans, strict=True)
    )
    return Grid(inverse, mi.Vector3f(*last), mi.Vector2u(y, z), mask, first)

"""The only neighbour search of the project: points sorted by grid cell.

Points are sorted by the linear index of their cell, x fastest. A query visits the rows of cells
that its ball touches; the points of one row are contiguous. If the grid has many more cells than
points, rows share buckets (a hash), and a point counts only for the row that contains it: results
are exact in both cases.

A search for the k nearest points may have to look far. It uses further levels of the same points,
each with cells four times as large as the last, so that every search visits only a few rows.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi

from gpf.core.recordable import Recordable


class Record(NamedTuple):
    """What is stored with a point: its position, a number, and a colour if the points have one."""

    p: mi.Point3f
    tag: mi.Float
    colour: mi.Color3f


# Called for each candidate of a query: body(state, index, record, distance², inside) -> state.
Body = Callable[[Any, "mi.UInt32", Record, "mi.Float", "mi.Bool"], Any]

# Decides which candidates count: accept(index, record, inside) -> inside.
Accept = Callable[["mi.UInt32", Record, "mi.Bool"], "mi.Bool"]

NOT_FOUND = 0xFFFFFFFF

# Ratio of the edge lengths of the cells of two consecutive levels.
_LEVEL_RATIO = 4


@dataclass
class _Grid:
    """Constants of one level: the cell of a point, and the cell's bucket in the tables."""

    inv_cell: mi.Float
    last_x: mi.Float
    last_y: mi.Float
    last_z: mi.Float
    stride_y: mi.UInt32
    stride_z: mi.UInt32
    mask: mi.UInt32
    first_bucket: mi.UInt32


class SpatialHash(Recordable):
    """Sorted points with exact radius and k-nearest queries.

    Parameters
    ----------
    points: positions, (N, 3).
    cell: edge length of a grid cell, world units; queries are fastest if it is
        about the usual query radius.
    bounds: two opposite corners of a box around the points. Points outside are found as well, but
        more slowly.
    tag: a number that is stored with each point, (N,); 0 by default.
    colour: a colour that is stored with each point, (N, 3); none by default. Reading it with the
        position takes three quarters of the time of reading the two separately.
    far: whether to build the levels that :meth:`nearest` needs.

    Attributes
    ----------
    order: index into ``points`` of each sorted entry, level by level, (levels N,).
    records: the sorted entries, flat: ``x, y, z, tag``, and ``red, green, blue, 0`` if there are
        colours, (4 or 8 levels N,).
    extent: the larger of the diagonal of the bounds and ``cell``, world units.
    """

    READ = ("_lower", "_slack", "_cell", "_first", "_levels", "_last_level", "_starts", "records")

    def __init__(
        self,
        points: mi.Point3f,
        *,
        cell: float,
        bounds: tuple[Any, Any],
        tag: mi.Float | None = None,
        colour: mi.Color3f | None = None,
        far: bool = False,
    ) -> None:
        size = dr.width(points)
        lower = [float(bounds[0][i]) for i in range(3)]
        edges = [float(bounds[1][i]) - lower[i] for i in range(3)]
        self.extent = max(math.hypot(*edges), cell)
        levels = 1
        while far and cell * _LEVEL_RATIO ** (levels - 1) < self.extent:
            levels += 1

        # Values that change from build to build are opaque, so that kernels are compiled once.
        self._lower = mi.Point3f(*(dr.opaque(mi.Float, v) for v in lower))
        self._slack = dr.opaque(mi.Float, 1e-6 * self.extent)
        self._cell = dr.opaque(mi.Float, cell)
        self._wraps = False
        grids, starts, orders = [], [], []
        buckets_before = 0
        for level in range(levels):
            grid, buckets = self._plan(cell * _LEVEL_RATIO**level, edges, size, buckets_before)
            grids.append(grid)
            order, start = self._sort(_opaque(grid), points, buckets, level * size)
            orders.append(order)
            starts.append(start)
            buckets_before += buckets + 2
        self._first = _opaque(grids[0])
        self._levels = _stack(grids)
        self._last_level = dr.opaque(mi.UInt32, levels - 1)
        self._starts = dr.concat(starts) if levels > 1 else starts[0]
        self.order = dr.concat(orders) if levels > 1 else orders[0]
        p = dr.gather(mi.Point3f, points, self.order)
        w = mi.Float(0) if tag is None else dr.gather(mi.Float, tag, self.order)
        columns = [p.x, p.y, p.z, w]
        if colour is not None:
            columns += [*dr.gather(mi.Color3f, colour, self.order), mi.Float(0)]
        self._columns = len(columns)
        self.records = dr.ravel(mi.ArrayXf(columns))
        dr.eval(self._starts, self.order, self.records)

    def record(self, index: mi.UInt32, active: mi.Bool) -> Record:
        """The records at positions in the sorted order, (N,)."""
        shape = (self._columns, dr.width(index))
        x, y, z, tag, *more = dr.gather(mi.ArrayXf, self.records, index, active, shape=shape)
        return Record(mi.Point3f(x, y, z), tag, mi.Color3f(*more[:3]) if more else mi.Color3f(0))

    def _plan(
        self, cell: float, edges: list[float], size: int, first_bucket: int
    ) -> tuple[_Grid, int]:
        """Constants of a level with cells of edge length ``cell``, and its number of buckets."""
        x, y, z = (max(1, int(e / cell) + 1) for e in edges)
        # A power of two, so that a bit mask maps a row's index into the table.
        table = 1 << (min(x * y * z, max(4 * size, 1 << 20)) - 1).bit_length()
        self._wraps |= x * y * z > table
        # The product may exceed 32 bits; only the bits that the mask keeps matter.
        stride_z = x * y & 0xFFFFFFFF
        grid = _Grid(1 / cell, x - 1, y - 1, z - 1, x, stride_z, table - 1, first_bucket)
        # The last row needs x more buckets. The number is rounded up to a power of two, because
        # each table size needs its own kernel.
        return grid, table + (1 << (x + 1).bit_length()) - 2

    def _sort(
        self, grid: _Grid, points: mi.Point3f, buckets: int, first: int
    ) -> tuple[mi.UInt32, mi.UInt32]:
        """The order of the points by bucket, and the start of each bucket plus ``first``."""
        c = self._cell_of(grid, points)
        bucket = self._row(grid, c.y, c.z) - grid.first_bucket + mi.UInt32(c.x)
        counts = dr.zeros(mi.UInt32, buckets + 2)
        dr.scatter_add(counts, mi.UInt32(1), bucket)
        starts = dr.prefix_reduce(dr.ReduceOp.Add, counts, exclusive=True)
        return dr.argsort(bucket), starts + dr.opaque(mi.UInt32, first)

    def _cell_of(self, grid: _Grid, p: mi.Point3f) -> mi.Vector3i:
        # Points outside the bounds belong to the outermost cells. Queries stay exact, because
        # clipping is monotone.
        last = mi.Vector3f(grid.last_x, grid.last_y, grid.last_z)
        return mi.Vector3i(dr.clip((p - self._lower) * grid.inv_cell, 0, last))

    def _row(self, grid: _Grid, y: mi.Int32, z: mi.Int32) -> mi.UInt32:
        index = mi.UInt32(y) * grid.stride_y + mi.UInt32(z) * grid.stride_z
        return (index & grid.mask) + grid.first_bucket

    def visit(
        self,
        x: mi.Point3f,
        radius: mi.Float,
        body: Body,
        state: Any,
        active: mi.Bool,
        enough: Callable[[Any], mi.Bool] | None = None,
        within: mi.Vector3f | None = None,
    ) -> Any:
        """Call ``body`` for every point that may lie within ``radius`` of ``x``; return the state.

        ``body(state, index, record, distance², inside)`` returns the new state. ``index`` is the
        position of the point in the sorted order, ``record`` its :class:`Record`, and ``inside``
        tells whether ``distance <= radius``: ``body`` must mask its side effects with it. A
        lane's search ends when ``enough(state)`` is true. Points farther away than ``within`` along
        an axis, world units, (N, 3), may be left out.
        """
        return self._scan(self._first, x, radius, body, state, active, enough, within)

    @dr.syntax
    def _scan(  # type: ignore[no-untyped-def]
        self, grid: _Grid, x, radius, body: Body, state, active, enough=None, within=None
    ):
        reach = mi.Vector3f(radius if within is None else within) + self._slack
        first = self._cell_of(grid, x - reach)
        last = self._cell_of(grid, x + reach)
        radius2 = radius * radius

        def searching(state):  # type: ignore[no-untyped-def]
            return active if enough is None else active & ~enough(state)

        # Exclude from each loop's state what the loop does not change. Otherwise, Dr.Jit traces the
        # loop once more to find that out, and the innermost of four loops 16 times.
        z = mi.Int32(first.z)
        while dr.hint(
            searching(state) & (z <= last.z), exclude=[active, x, grid, radius2, first, last]
        ):
            y = mi.Int32(first.y)
            while dr.hint(
                searching(state) & (y <= last.y), exclude=[active, x, grid, radius2, first, last, z]
            ):
                row = self._row(grid, y, z)
                index = dr.gather(mi.UInt32, self._starts, row + mi.UInt32(first.x), active)
                end = dr.gather(mi.UInt32, self._starts, row + mi.UInt32(last.x) + 1, active)
                while dr.hint(
                    searching(state) & (index < end), exclude=[active, x, grid, radius2, end, y, z]
                ):
                    record = self.record(index, active)
                    distance2 = dr.squared_norm(record.p - x)
                    inside = distance2 <= radius2
                    if dr.hint(self._wraps, mode="scalar"):
                        c = self._cell_of(grid, record.p)
                        inside &= (c.y == y) & (c.z == z)
                    state = body(state, index, record, distance2, inside)
                    index += 1
                y += 1
            z += 1
        return state

    @dr.syntax
    def nearest(
        self,
        x: mi.Point3f,
        k: int,
        start: mi.Float,
        limit: mi.Float,
        accept: Accept | None = None,
        active: mi.Bool | bool = True,
    ) -> tuple[list[mi.UInt32], list[mi.Float]]:
        """The ``k`` nearest points of each query, nearest first. Needs ``far=True``.

        Balls of radius ``start``, 2 ``start``, … up to ``limit`` are searched until one contains
        ``k`` points that ``accept(index, record, inside)`` accepts. The result is exact within the
        last ball searched.

        Returns
        -------
        index: list of ``k`` arrays (N,), positions in the sorted order. A missing neighbour has
            index :data:`NOT_FOUND` and an infinite distance.
        distance2: list of ``k`` arrays (N,), squared distances, ascending.
        """
        index = [dr.full(mi.UInt32, NOT_FOUND, dr.width(x)) for _ in range(k)]
        distance2 = [dr.full(mi.Float, dr.inf, dr.width(x)) for _ in range(k)]
        radius = mi.Float(start)
        searching = mi.Bool(active)
        while dr.hint(searching, exclude=[x, limit]):
            grid = self._level_for(radius, searching)
            index, distance2 = self._scan(
                grid, x, radius, _insert(accept), _nothing_found(k), mi.Bool(searching)
            )
            searching &= (distance2[k - 1] == dr.inf) & (radius < limit)
            radius = dr.minimum(2 * radius, limit)
        return index, distance2

    def _level_for(self, radius: mi.Float, active: mi.Bool) -> _Grid:
        """The first level whose cells are at least half as large as the radius."""
        steps = dr.ceil(dr.log2(0.5 * radius / self._cell) / math.log2(_LEVEL_RATIO))
        level = dr.minimum(mi.UInt32(dr.maximum(steps, 0)), self._last_level)
        names = [f.name for f in fields(_Grid)]
        tables = [getattr(self._levels, name) for name in names]
        return _Grid(*(dr.gather(type(t), t, level, active) for t in tables))


def _opaque(grid: _Grid) -> _Grid:
    values = [getattr(grid, f.name) for f in fields(_Grid)]
    return _Grid(
        *(dr.opaque(_type_of(f.name), v) for f, v in zip(fields(_Grid), values, strict=True))
    )


def _stack(grids: list[_Grid]) -> _Grid:
    return _Grid(*(_type_of(f.name)([getattr(g, f.name) for g in grids]) for f in fields(_Grid)))


def _type_of(name: str) -> Any:
    return mi.Float if name.startswith(("inv", "last")) else mi.UInt32


def _nothing_found(k: int) -> tuple[list[mi.UInt32], list[mi.Float]]:
    return [mi.UInt32(NOT_FOUND)] * k, [mi.Float(dr.inf)] * k


def _insert(accept: Accept | None) -> Body:
    """A body that keeps the nearest candidates in ascending order (an insertion network)."""

    def body(state, index, record, distance2, inside):  # type: ignore[no-untyped-def]
        indices, distances = state
        if accept is not None:
            inside = accept(index, record, inside)
        distance = dr.select(inside, distance2, dr.inf)
        new_indices, new_distances = [], []
        for best, best_index in zip(distances, indices, strict=True):
            closer = distance < best
            new_distances.append(dr.select(closer, distance, best))
            new_indices.append(dr.select(closer, index, best_index))
            distance, index = (
                dr.select(closer, best, distance),
                dr.select(closer, best_index, index),
            )
        return new_indices, new_distances

    return body

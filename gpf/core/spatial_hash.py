"""The only neighbour search of the project: points sorted by grid cell.

Points are sorted by the linear index of their cell, x fastest. A query visits the rows of cells
that its ball touches; the points of one row are contiguous. If the grid has many more cells than
points, rows share buckets (a hash), and a point counts only for the row that contains it: results
are exact in both cases.

A search for the k nearest points may have to look far. It uses further levels of the same points,
each with cells four times as large as the last, so that every search visits only a few rows.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi

from gpf.core.grid_levels import Grid, GridLevels
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
    levels: the grids.
    """

    READ = ("levels", "records", "_starts")

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
        self.levels = GridLevels(cell, bounds, dr.width(points), far)
        self.order, self._starts = self.levels.sort(points)
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
        return self._scan(self.levels.first, x, radius, body, state, active, enough, within)

    @dr.syntax
    def _scan(  # type: ignore[no-untyped-def]
        self, grid: Grid, x, radius, body: Body, state, active, enough=None, within=None
    ):
        reach = mi.Vector3f(radius if within is None else within) + self.levels.slack
        first = self.levels.cell_of(grid, x - reach)
        last = self.levels.cell_of(grid, x + reach)
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
                row = grid.row(y, z)
                index = dr.gather(mi.UInt32, self._starts, row + mi.UInt32(first.x), active)
                end = dr.gather(mi.UInt32, self._starts, row + mi.UInt32(last.x) + 1, active)
                while dr.hint(
                    searching(state) & (index < end), exclude=[active, x, grid, radius2, end, y, z]
                ):
                    record = self.record(index, active)
                    distance2 = dr.squared_norm(record.p - x)
                    inside = distance2 <= radius2
                    if dr.hint(self.levels.wraps, mode="scalar"):
                        c = self.levels.cell_of(grid, record.p)
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
            grid = self.levels.fit(radius, searching)
            index, distance2 = self._scan(
                grid, x, radius, _insert(accept), _nothing_found(k), mi.Bool(searching)
            )
            searching &= (distance2[k - 1] == dr.inf) & (radius < limit)
            radius = dr.minimum(2 * radius, limit)
        return index, distance2


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

"""How fine a field is at each place.

Smooth light needs few Gaussians: more would only learn noise. Sharp light needs many. So each cell
of a coarse grid has a level. At level l, all lengths are 2^l times smaller than at level 0,
including the radius of a query. A query uses Gaussians of its own level only.

One search with one radius serves all levels, in an *unfolded* space: everything at level l is
scaled by 2^l and moved into a box of its own, beside those of the other levels:

    x' = 2^l (x - corner) + offset_l
"""

from __future__ import annotations

import itertools
from functools import cached_property
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.recordable import Recordable
from gpf.core.structs import from_numpy

# A query takes the level of a nearby point, at most this far away on each axis, in cells. Over this
# distance one level fades into the next; otherwise the edges of cells would show.
FADE = 0.25

# Free space between the boxes of two levels, in search radii. Queries look up to 4 radii away.
_GAP = 8.0


class Detail(Recordable):
    """The level of each cell of a grid, and the unfolded space.

    Parameters
    ----------
    table: levels, (X, Y, Z) uint8.
    width: edge length of a cell, world units.
    corner: the lowest corner of the grid, world units, (3,).
    radius: search radius at level 0, world units.
    """

    READ = ("_arrays",)

    def __init__(self, table: np.ndarray, width: float, corner: np.ndarray, radius: float) -> None:
        self.table, self.width = table, width
        self.corner, self.radius = np.asarray(corner, dtype=float), radius
        self.count = int(table.max()) + 1
        extent = np.array(table.shape) * width
        scales = 2.0 ** np.arange(self.count)
        starts = np.cumsum([0, *(scales * extent[0] + _GAP * radius)])
        self.starts = starts[:-1]
        """The lowest x of each level's box."""
        self.bounds = (0.0, 0.0, 0.0), (starts[-1], *(scales[-1] * extent[1:]))
        """Corners of a box around the unfolded space."""

    def around(self, lower: np.ndarray, upper: np.ndarray, most: int) -> Detail | None:
        """The same levels on a grid that also contains the box with these corners, (3,): new cells
        have the level of the nearest old one. None if there would be more than ``most`` cells."""
        before = np.ceil((self.corner - lower) / self.width)
        after = np.ceil((upper - self.corner) / self.width) - self.table.shape
        more = np.maximum(np.column_stack([before, after]), 0).astype(np.int64)
        if not more.any():
            return self
        if np.prod(self.table.shape + more.sum(axis=1), dtype=float) > most:
            return None
        table = np.pad(self.table, more, mode="edge")
        return Detail(table, self.width, self.corner - more[:, 0] * self.width, self.radius)

    @cached_property
    def _arrays(self) -> dict[str, Any]:
        """What queries read. Opaque, so that kernels are compiled once for all tables."""
        _, y, z = self.table.shape
        found = {
            "levels": from_numpy(mi.UInt32, self.table.ravel()),
            "starts": from_numpy(mi.Float, self.starts),
            "corner": mi.Point3f(*(dr.opaque(mi.Float, float(c)) for c in self.corner)),
            "inverse": dr.opaque(mi.Float, 1 / self.width),
            "last": mi.Vector3i(*(dr.opaque(mi.Int32, n - 1) for n in self.table.shape)),
            "stride": mi.Vector3u(dr.opaque(mi.UInt32, y * z), dr.opaque(mi.UInt32, z), 1),
        }
        dr.make_opaque(found)
        return found

    def unfold(self, x: mi.Point3f) -> mi.Point3f:
        """Points in the unfolded space, at the levels of queries at ``x``, (N, 3)."""
        return self.unfold_to(x, self._level(x))

    def scale(self, x: mi.Point3f) -> mi.Float:
        """How much longer lengths are in the unfolded space, at queries at ``x``, (N,)."""
        return mi.Float(mi.UInt32(1) << self._level(x))

    def _level(self, x: mi.Point3f) -> mi.UInt32:
        a = self._arrays
        cell = (x - a["corner"]) * a["inverse"] + FADE * _scatter(x)
        index = mi.Vector3u(dr.clip(mi.Vector3i(dr.floor(cell)), 0, a["last"]))
        return dr.gather(mi.UInt32, a["levels"], dr.dot(index, a["stride"]))

    def unfold_to(self, x: mi.Point3f, level: mi.UInt32) -> mi.Point3f:
        """Points in the boxes of the given levels, (N, 3)."""
        a = self._arrays
        y = (x - a["corner"]) * mi.Float(mi.UInt32(1) << level)
        return mi.Point3f(y.x + dr.gather(mi.Float, a["starts"], level), y.y, y.z)

    def reaches(self, x: np.ndarray, level: int) -> np.ndarray:
        """Which of the points (P, 3) queries of a level may reach, (P,) bool."""
        from scipy.ndimage import maximum_filter  # slow to import

        reach = self.radius / 2**level + FADE * self.width
        whole = maximum_filter(self.table == level, 2 * int(reach / self.width) + 1)
        found = self._at(whole, x)
        near = np.flatnonzero(self._at(maximum_filter(whole, 3), x) & ~found)
        rest = reach % self.width
        for offset in itertools.product((-rest, 0, rest), repeat=3):
            found[near] |= self._at(whole, x[near] + offset)
        return found

    def _at(self, values: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Values of cells, (X, Y, Z), at points (P, 3)."""
        cell = ((x - self.corner) / self.width).astype(np.int64)
        cell = np.clip(cell, 0, np.array(values.shape) - 1)
        return np.asarray(values[cell[:, 0], cell[:, 1], cell[:, 2]])

    def unfold_all(self, x: np.ndarray, level: int) -> np.ndarray:
        """Points (P, 3) in the box of a level, (P, 3)."""
        return (x - self.corner) * 2.0**level + [self.starts[level], 0, 0]

    def levels_at(self, x: np.ndarray) -> np.ndarray:
        """The levels of the cells in which points (N, 3) lie, (N,) uint8."""
        return self._at(self.table, x)

    def levels_of(self, unfolded: np.ndarray) -> np.ndarray:
        """The levels in whose boxes unfolded points (N, 3) lie, (N,) uint8."""
        edges = self.starts[1:] - _GAP / 2 * self.radius
        return np.searchsorted(edges, unfolded[:, 0]).astype(np.uint8)

    def fold(self, unfolded: np.ndarray) -> np.ndarray:
        """World positions of unfolded points, (N, 3)."""
        level = self.levels_of(unfolded)
        moved = np.array(unfolded, dtype=float)
        moved[:, 0] -= self.starts[level]
        return moved / 2.0 ** level[:, None] + self.corner


def _scatter(x: mi.Point3f) -> mi.Vector3f:
    """Values in [-1, 1) that look random but depend on the points alone, (N, 3)."""
    bits = [dr.reinterpret_array(mi.UInt32, value) for value in (x.x, x.y, x.z)]
    a, b = mi.sample_tea_32(bits[0] ^ (bits[2] << 7), bits[1] ^ (bits[2] >> 5), 4)
    # 16 bits for each of three values, from two words of 32.
    words = (a & 0xFFFF, a >> 16, b & 0xFFFF)
    return mi.Vector3f(*(mi.Float(word) * (1 / 32768) - 1 for word in words))

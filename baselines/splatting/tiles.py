"""Lists of the footprints in each tile of an image, nearest first."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from baselines.splatting.projection import Footprints

# Pixels along a tile's edge. Its 64 pixels are 16 lanes of 2×2 pixels, one packet of a 512-bit
# vector unit: all lanes use the same list and read each footprint once for four pixels.
TILE = 8


@dataclass
class TileLists:
    """Footprints by tile; tiles are ordered by row, then column.

    Attributes
    ----------
    starts: index of each list's beginning, and the end, (tiles + 1,).
    indices: footprints of all lists, ordered by depth within each list.
    size: width and height of the image, pixels.
    """

    starts: mi.UInt32
    indices: mi.UInt32
    size: tuple[int, int]

    @property
    def tiles(self) -> tuple[int, int]:
        """The numbers of tiles across and down."""
        return -(-self.size[0] // TILE), -(-self.size[1] // TILE)


def sort_into_tiles(found: Footprints, size: tuple[int, int]) -> TileLists:
    """Lists of the footprints whose bounding boxes meet each tile."""
    lists = TileLists(mi.UInt32(0), mi.UInt32(0), size)
    across, down = lists.tiles
    seen = found.extents.x > 0
    # The bits of positive floats, as integers, have the order of the floats.
    order = dr.argsort(dr.reinterpret_array(mi.UInt32, dr.select(seen, found.depths, dr.inf)))

    centre = dr.gather(mi.Vector2f, found.centres, order)
    extent = dr.gather(mi.Vector2f, found.extents, order)
    last = mi.Vector2f(dr.opaque(mi.Float, across - 1), dr.opaque(mi.Float, down - 1))
    low, high = (dr.floor((centre + sign * extent) * (1 / TILE)) for sign in (-1, 1))
    meets = (extent.x > 0) & dr.all((high >= 0) & (low <= last))
    low, high = (mi.Vector2u(dr.clip(corner, 0, last)) for corner in (low, high))
    width = high.x - low.x + 1
    count = dr.select(meets, width * (high.y - low.y + 1), 0)
    ends = dr.prefix_reduce(dr.ReduceOp.Add, count, exclusive=False)
    dr.eval(order, low, width, count, ends)
    total = int(ends[-1])

    # One element more than needed, because Dr.Jit has no empty arrays.
    tiles = dr.full(mi.UInt32, across * down, total + 1)
    owners = dr.zeros(mi.UInt32, total + 1)
    _write_pairs(
        low, width, count, ends - count, order, dr.opaque(mi.UInt32, across), tiles, owners
    )
    by_tile = dr.argsort(tiles)  # stable, so the order by depth is kept
    lists.indices = dr.gather(mi.UInt32, owners, by_tile)
    counts = dr.zeros(mi.UInt32, across * down + 1)
    dr.scatter_add(counts, mi.UInt32(1), tiles)
    lists.starts = dr.prefix_reduce(dr.ReduceOp.Add, counts, exclusive=True)
    dr.eval(lists.indices, lists.starts)
    return lists


@dr.syntax
def _write_pairs(
    low: mi.Vector2u,
    width: mi.UInt32,
    count: mi.UInt32,
    start: mi.UInt32,
    owner: mi.UInt32,
    across: mi.UInt32,
    tiles: mi.UInt32,
    owners: mi.UInt32,
) -> None:
    """Write tile and footprint of each pair; the pairs of a footprint are ordered by row."""
    done = mi.UInt32(0)
    column = mi.UInt32(0)
    row_start = low.y * across + low.x
    while done < count:
        dr.scatter(tiles, row_start + column, start + done)
        dr.scatter(owners, owner, start + done)
        done += 1
        column += 1
        if column == width:
            column = mi.UInt32(0)
            row_start += across

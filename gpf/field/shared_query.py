"""Queries of a field at many points, such as those that rays find: close ones share an answer.

The lanes of a packet run in step, so they should look at the same Gaussians: points that are close
and face the same way are queried together, and no lane of a packet is idle.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from gpf.core.morton import order_lanes_in_space
from gpf.core.structs import concatenate
from gpf.core.surface_tags import pack_tag, unpack_normal
from gpf.field.field import GaussianPhotonField

NEAR = 0.05
"""Points at most this far apart, in search radii of their level, may share an answer: it is that of
the point nearest to the middle of a cell of this size."""

SAME_SIDE = 0.95
"""Smallest cosine between the normals of points that share an answer."""

# Number of cells: the places of a hash table. A point whose place another one has taken that is not
# close gets a second one, in a grid shifted by half a cell. Whoever is unlucky twice has an answer
# of its own.
_CELLS = 1 << 18


def query_shared(
    field: GaussianPhotonField, p: mi.Point3f, n: mi.Normal3f, asks: mi.Bool, near: float = NEAR
) -> tuple[mi.Color3f, mi.Float]:
    """The field's answers at evaluated points; see :meth:`GaussianPhotonField.query`.

    Parameters
    ----------
    p, n: positions and viewer-side normals, (N, 3).
    asks: where answers are wanted, (N,).
    near: how close points are that share an answer, in search radii; 0: none do.
    """
    lanes = dr.arange(mi.UInt32, dr.width(asks))
    own, cell, leader = asks, mi.UInt32(0), lanes
    if near > 0:
        own, cell, leader = _shared_cells(field, p, n, asks, near)
    asking = dr.compress(own | (asks & (dr.gather(mi.UInt32, leader, cell, asks) == lanes)))
    if dr.width(asking) == 0:
        return mi.Color3f(0), mi.Float(dr.inf)
    asking = in_order(field, p, n, asking)
    at = dr.gather(mi.Point3f, p, asking), dr.gather(mi.Normal3f, n, asking)
    value, reach = field.query(*at, mi.Bool(True))
    answers = dr.ravel(mi.Vector4f(*value, reach))
    place = dr.zeros(mi.UInt32, dr.width(asks))
    dr.scatter(place, dr.arange(mi.UInt32, dr.width(asking)), asking)
    of_cell = dr.gather(mi.UInt32, place, leader, leader < dr.width(asks))
    dr.eval(answers, place, of_cell)
    index = dr.select(own, place, dr.gather(mi.UInt32, of_cell, cell, asks & ~own))
    found = dr.gather(mi.Vector4f, answers, index, asks)
    return mi.Color3f(*found.xyz), dr.select(asks, found.w, dr.inf)


def in_order(
    field: GaussianPhotonField, p: mi.Point3f, n: mi.Normal3f, lanes: mi.UInt32
) -> mi.UInt32:
    """Some lanes, (M,), with those next to each other that look at the same Gaussians.

    ``p``, ``n``: positions and normals of all lanes, (N, 3); the normals are 0 in media.
    """
    radius = field.settings.search_radius
    x = field.unfold(dr.gather(mi.Point3f, p, lanes))
    facing = mi.Vector3f(dr.gather(mi.Normal3f, n, lanes))
    return dr.gather(mi.UInt32, lanes, order_lanes_in_space(x + radius * facing, radius / 8))


def _shared_cells(
    field: GaussianPhotonField, p: mi.Point3f, n: mi.Normal3f, asks: mi.Bool, near: float
) -> tuple[mi.Bool, mi.UInt32, mi.UInt32]:
    """Which lanes need an answer of their own, (N,); the cells of the others, (N,); and the lane
    that asks for each cell, (C,), or a larger number."""
    width = dr.opaque(mi.Float, near * field.settings.search_radius)
    x, lanes = field.unfold(p), dr.arange(mi.UInt32, dr.width(asks))
    dr.eval(x)
    # A cell keeps the number of a lane below that lane's distance from its middle.
    bits = dr.width(asks).bit_length()
    lane_bits, steps = dr.opaque(mi.UInt32, bits), dr.opaque(mi.Float, float(1 << (32 - bits)))
    own, chosen, leaders = mi.Bool(asks), dr.zeros(mi.UInt32, dr.width(asks)), []
    for number, shift in enumerate((0, 0.5)):
        place = x / width + shift
        corner = dr.floor(place)
        cell = _hash(mi.Vector3i(corner), mi.Vector3i(dr.round(n))) % _CELLS
        away = mi.UInt32(dr.squared_norm(place - corner - 0.5) * steps)
        best = dr.full(mi.UInt32, 0xFFFFFFFF, _CELLS)
        dr.scatter_reduce(dr.ReduceOp.Min, best, (away << lane_bits) | lanes, cell, own)
        leader = best & ((mi.UInt32(1) << lane_bits) - 1)
        taken = leader < dr.width(asks)
        # They are read at random: all of a leader from one place in memory.
        at = dr.gather(mi.Point3f, x, leader, taken)
        facing = pack_tag(dr.gather(mi.Normal3f, n, leader, taken))
        records = dr.ravel(mi.Vector4f(*at, facing))
        dr.eval(leader, records)
        there = dr.gather(mi.Vector4f, records, cell, own)
        close = dr.squared_norm(x - there.xyz) < dr.square(width)
        close &= dr.dot(n, unpack_normal(there.w)) > SAME_SIDE
        chosen = dr.select(own & close, cell + number * _CELLS, chosen)
        own &= ~close
        dr.eval(chosen, own)
        leaders.append(leader)
    return own, chosen, concatenate(leaders)


def _hash(cell: mi.Vector3i, facing: mi.Vector3i) -> mi.UInt32:
    a = mi.UInt32(cell.x) + mi.UInt32(facing.x) * 0x9E3779B1
    b = mi.UInt32(cell.y) + mi.UInt32(facing.y) * 0x85EBCA77
    c = mi.UInt32(cell.z) + mi.UInt32(facing.z) * 0xC2B2AE3D
    return mi.sample_tea_32(a * 0x27D4EB2F + c, b, 4)[0]

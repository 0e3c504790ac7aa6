"""Queries of a field at many points, such as those that rays find: close ones share an answer.

The lanes of a packet run in step, so they should look at the same Gaussians: points that are close
and face the same way are queried together, and no lane of a packet is idle.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from gpf.core.morton import order_lanes_in_space
from gpf.field.field import GaussianPhotonField

NEAR = 0.05
"""Points at most this far apart, in search radii of their level, may share an answer: it is that of
the point nearest to the middle of a cell of this size."""

SAME_SIDE = 0.95
"""Smallest cosine between the normals of points that share an answer."""

# Cells share this many slots; a point whose slot another cell has taken gets a second one, in a
# grid shifted by half a cell. Whoever is unlucky twice has an answer of its own.
_SLOTS = 1 << 20


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
    leader = _leaders(field, p, n, asks, near) if near > 0 else lanes
    asking = dr.compress(asks & (leader == lanes))
    if dr.width(asking) == 0:
        return mi.Color3f(0), mi.Float(dr.inf)
    asking = in_order(field, p, n, asking)
    own = dr.gather(mi.Point3f, p, asking), dr.gather(mi.Normal3f, n, asking)
    value, reach = field.query(*own, mi.Bool(True))
    place = dr.zeros(mi.UInt32, dr.width(asks))
    dr.scatter(place, dr.arange(mi.UInt32, dr.width(asking)), asking)
    dr.eval(value, reach, place)
    index = dr.gather(mi.UInt32, place, leader, asks)
    return answer(value, index, asks), dr.select(asks, answer(reach, index, asks), dr.inf)


def answer(values: Any, index: mi.UInt32, active: mi.Bool) -> Any:
    """The answers of lanes, zero where not active; a value with one lane is the same for all."""
    if dr.width(values) == 1:
        return dr.select(active, values, dr.zeros(type(values)))
    return dr.gather(type(values), values, index, active)


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


def _leaders(
    field: GaussianPhotonField, p: mi.Point3f, n: mi.Normal3f, asks: mi.Bool, near: float
) -> mi.UInt32:
    """The lane whose answer each lane may use, (N,): in many cases, itself."""
    cell = dr.opaque(mi.Float, near * field.settings.search_radius)
    x, lanes = field.unfold(p), dr.arange(mi.UInt32, dr.width(asks))
    dr.eval(x)
    leader, open_ = mi.UInt32(lanes), mi.Bool(asks)
    for shift in (0, 0.5):
        place = x / cell + shift
        corner = dr.floor(place)
        slot = _hash(mi.Vector3i(corner), mi.Vector3i(dr.round(n))) % _SLOTS
        # The nearest to the middle of the cell, and of equals the first.
        away = dr.reinterpret_array(mi.UInt32, dr.squared_norm(place - corner - 0.5))
        best = dr.full(mi.UInt64, (1 << 64) - 1, _SLOTS)
        dr.scatter_reduce(
            dr.ReduceOp.Min, best, (mi.UInt64(away) << 32) | mi.UInt64(lanes), slot, open_
        )
        dr.eval(best)
        first = mi.UInt32(dr.gather(mi.UInt64, best, slot, open_) & 0xFFFFFFFF)
        close = dr.squared_norm(x - dr.gather(mi.Point3f, x, first, open_)) < dr.square(cell)
        close &= dr.dot(n, dr.gather(mi.Normal3f, n, first, open_)) > SAME_SIDE
        leader = dr.select(open_ & close, first, leader)
        open_ &= ~close
        dr.eval(leader, open_)
    return leader


def _hash(cell: mi.Vector3i, facing: mi.Vector3i) -> mi.UInt32:
    a = mi.UInt32(cell.x) + mi.UInt32(facing.x) * 0x9E3779B1
    b = mi.UInt32(cell.y) + mi.UInt32(facing.y) * 0x85EBCA77
    c = mi.UInt32(cell.z) + mi.UInt32(facing.z) * 0xC2B2AE3D
    return mi.sample_tea_32(a * 0x27D4EB2F + c, b, 4)[0]

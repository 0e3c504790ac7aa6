"""Queries of a field at points in no particular order, such as those that rays find."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from gpf.core.morton import order_lanes_in_space
from gpf.field.field import GaussianPhotonField


def query_in_order(
    field: GaussianPhotonField, p: mi.Point3f, n: mi.Normal3f, asks: mi.Bool
) -> tuple[mi.Color3f, mi.Float, mi.UInt32]:
    """The field's answers at evaluated points; see :meth:`GaussianPhotonField.query`.

    The lanes of a packet run in step, so they should look at the same Gaussians: points that are
    close and face the same way are queried together, and no lane of a packet is idle.

    Parameters
    ----------
    p, n: positions and viewer-side normals, (N, 3).
    asks: where answers are wanted, (N,).

    Returns
    -------
    value, reach: answers for the M points that ask, (M, 3) and (M,); a single lane if none does.
    place: index of each asking point's answer among these, (N,).
    """
    asking = dr.compress(asks)
    place = dr.zeros(mi.UInt32, dr.width(asks))
    if dr.width(asking) == 0:
        return mi.Color3f(0), mi.Float(dr.inf), place
    asking = in_order(field, p, n, asking)
    p, n = dr.gather(mi.Point3f, p, asking), dr.gather(mi.Normal3f, n, asking)
    value, reach = field.query(p, n, mi.Bool(True))
    dr.scatter(place, dr.arange(mi.UInt32, dr.width(asking)), asking)
    dr.eval(value, reach, place)
    return value, reach, place


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

"""What stands on a surface separates photons that lie close together on it.

On both sides of a wall that stands on a floor the light is another, and under a box that stands on
it there is none, although the floor goes on. Short rays along the surface find the nearest obstacle
in each of some directions around a point. A photon behind it does not count, nor does the part of
the kernel's disc that lies there (:mod:`gpf.sppm.edge_correction`).
"""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.structs import from_numpy
from gpf.scene.obstacles import Obstacle, look_along

Hidden = Callable[["mi.Vector3f"], "mi.Bool"]
"""Whether places are hidden from points, (N,), by their offsets from the points, (N, 3)."""

SECTORS = 16
"""Directions around a point."""

# Of a point between obstacles that leave less than this part of the disc free, as in a carpet, none
# counts: too few photons would be left.
_LEAST_FREE = 0.125

# With this, nothing is behind the plane of a sector.
_NOWHERE = -1e30


def nowhere(offset: mi.Vector3f) -> mi.Bool:
    """Nothing is hidden."""
    return mi.Bool(False)


class Obstacles:
    """The nearest obstacles around points on surfaces, one in each of :data:`SECTORS` sectors.

    An obstacle is taken for a plane that stands upright on the surface: in the frame of the point's
    normal, the place (x, y) is behind it if a x + b y < c.

    Parameters
    ----------
    p, n: positions and oriented normals, (N, 3).
    reach: how far away obstacles are found, world units.

    Attributes
    ----------
    near: whether obstacles of a point count, (N,) bool.
    """

    def __init__(self, scene: mi.Scene, p: mi.Point3f, n: mi.Normal3f, reach: float) -> None:
        met = _look_around(scene, p, n, reach, dr.arange(mi.UInt32, dr.width(p)))
        free = dr.select(met.stands, dr.square(met.t / reach), 1).numpy().reshape(-1, SECTORS)
        self.near = (free.min(axis=1) < 1) & (free.mean(axis=1) >= _LEAST_FREE)
        self._place = from_numpy(mi.UInt32, np.maximum(np.cumsum(self.near) - 1, 0))
        self._planes = mi.Float()
        if self.near.any():
            rows = from_numpy(mi.UInt32, np.flatnonzero(self.near))
            self._planes = _planes(scene, p, n, reach, rows)
            dr.eval(self._planes)

    def hide(self, row: mi.UInt32, n: mi.Normal3f, offset: mi.Vector3f) -> mi.Bool:
        """Whether places are behind an obstacle, (M,).

        Parameters
        ----------
        row: the points that they are seen from, all of them near obstacles, (M,).
        n: the points' normals, (M, 3).
        offset: from the points to the places, (M, 3).
        """
        local = mi.Frame3f(n).to_local(offset)
        turn = dr.atan2(local.y, local.x) * (0.5 / dr.pi)
        sector = mi.UInt32((turn - dr.floor(turn)) * SECTORS) % SECTORS
        index = dr.gather(mi.UInt32, self._place, row) * SECTORS + sector
        plane = dr.gather(mi.Vector3f, self._planes, index)
        return local.x * plane.x + local.y * plane.y < plane.z


def _look_around(
    scene: mi.Scene, p: mi.Point3f, n: mi.Normal3f, reach: float, rows: mi.UInt32
) -> Obstacle:
    """What the rays of points meet, one in the middle of each sector, (:data:`SECTORS` M,) for M
    rows."""
    row = dr.repeat(rows, SECTORS)
    number = mi.Float(dr.arange(mi.UInt32, dr.width(row)) % SECTORS)
    sine, cosine = dr.sincos((number + 0.5) * (2 * dr.pi / SECTORS))
    p, n = dr.gather(mi.Point3f, p, row), dr.gather(mi.Normal3f, n, row)
    return look_along(scene, p, n, dr.opaque(mi.Float, reach), mi.Vector2f(cosine, sine))


def _planes(
    scene: mi.Scene, p: mi.Point3f, n: mi.Normal3f, reach: float, rows: mi.UInt32
) -> mi.Float:
    """a, b and c of each sector, flat, (3 :data:`SECTORS` M,) for M rows."""
    met = _look_around(scene, p, n, reach, rows)
    limit = dr.select(met.stands, -met.distance, _NOWHERE)
    planes = mi.Vector3f(-met.away.x, -met.away.y, limit)
    dr.eval(planes)
    # A wall reaches a little way into the sectors beside those whose rays meet it.
    number = dr.arange(mi.UInt32, dr.width(planes))
    first = number - number % SECTORS
    for turn in (1, SECTORS - 1):
        beside = dr.gather(mi.Vector3f, planes, first + (number + turn) % SECTORS)
        planes = dr.select(planes.z > _NOWHERE, planes, beside)
        dr.eval(planes)
    return dr.ravel(planes)

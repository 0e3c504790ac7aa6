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
from gpf.core.surface_tags import SAME_SURFACE_COSINE

Hidden = Callable[["mi.Vector3f"], "mi.Bool"]
"""Whether places are hidden from points, (N,), by their offsets from the points, (N, 3)."""

SECTORS = 16
"""Directions around a point."""

# Height of the rays above the surface, in units of their length: what is lower is no obstacle.
_HEIGHT = 0.03

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
        everyone = dr.arange(mi.UInt32, dr.width(p))
        si, _ = _look_around(scene, p, n, reach, everyone)
        stands = _stands(si, n, everyone)
        free = dr.select(stands, dr.square(si.t / reach), 1).numpy().reshape(-1, SECTORS)
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
) -> tuple[mi.SurfaceInteraction3f, mi.Vector3f]:
    """What the rays of points find, and their directions in the frame of the point's normal;
    (:data:`SECTORS` M,) for M rows."""
    length = dr.opaque(mi.Float, reach)
    row = dr.repeat(rows, SECTORS)
    number = mi.Float(dr.arange(mi.UInt32, dr.width(row)) % SECTORS)
    sine, cosine = dr.sincos((number + 0.5) * (2 * dr.pi / SECTORS))
    normal = dr.gather(mi.Normal3f, n, row)
    direction = mi.Vector3f(cosine, sine, 0)
    origin = dr.gather(mi.Point3f, p, row) + _HEIGHT * length * normal
    ray = mi.Ray3f(origin, mi.Frame3f(normal).to_world(direction), length, 0, mi.Color0f())
    return scene.ray_intersect(ray, mi.RayFlags.Minimal, coherent=False), direction


def _stands(si: mi.SurfaceInteraction3f, n: mi.Normal3f, rows: mi.UInt32) -> mi.Bool:
    """Whether what was found is an obstacle, and not the surface of the point itself."""
    normal = dr.gather(mi.Normal3f, n, dr.repeat(rows, SECTORS))
    return si.is_valid() & (dr.dot(si.n, normal) < SAME_SURFACE_COSINE)


def _planes(
    scene: mi.Scene, p: mi.Point3f, n: mi.Normal3f, reach: float, rows: mi.UInt32
) -> mi.Float:
    """a, b and c of each sector, flat, (3 :data:`SECTORS` M,) for M rows."""
    si, direction = _look_around(scene, p, n, reach, rows)
    frame = mi.Frame3f(dr.gather(mi.Normal3f, n, dr.repeat(rows, SECTORS)))
    facing = frame.to_local(mi.Vector3f(si.n))
    # Towards the point; an obstacle that leans far over is taken to face it.
    flat = mi.Vector2f(facing.x, facing.y)
    flat *= -dr.sign(dr.dot(flat, direction.xy))
    flat = dr.select(dr.squared_norm(flat) > 0.01, dr.normalize(flat), -direction.xy)
    limit = si.t * dr.dot(flat, direction.xy)
    planes = mi.Vector3f(flat.x, flat.y, dr.select(_stands(si, n, rows), limit, _NOWHERE))
    dr.eval(planes)
    # A wall reaches a little way into the sectors beside those whose rays meet it.
    number = dr.arange(mi.UInt32, dr.width(planes))
    first = number - number % SECTORS
    for turn in (1, SECTORS - 1):
        beside = dr.gather(mi.Vector3f, planes, first + (number + turn) % SECTORS)
        planes = dr.select(planes.z > _NOWHERE, planes, beside)
        dr.eval(planes)
    return dr.ravel(planes)

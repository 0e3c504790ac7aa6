"""Find what stands on a surface, or lies above it, by tracing short rays.

A wall that stands on a floor separates the light on its two sides, although the floor continues
beneath it. An obstacle is treated as a plane that stands upright on the surface.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from gpf.core.surface_tags import SAME_SURFACE_COSINE

# Height of the rays above the surface, relative to their length: anything lower is not an obstacle.
_HEIGHT = 0.03

# Height at which rays straight up begin, relative to their length: not on the surface itself.
_START = 0.03


def look_along(
    scene: mi.Scene, p: mi.Point3f, n: mi.Normal3f, reach: mi.Float, direction: mi.Vector2f
) -> tuple[mi.Float, mi.Vector2f, mi.Float]:
    """The obstacles that rays from points on surfaces hit, other than the surface itself: lengths
    of the rays, infinite without one; unit vectors across the obstacles' planes, away from the
    points, in the frame of the normal; and distances of the planes, infinite likewise.

    Parameters
    ----------
    p, n: positions and unit normals, world units, (N, 3).
    reach: length of the rays, world units, (N,).
    direction: unit vectors in the frame of the normal, (N, 2).
    """
    frame = mi.Frame3f(n)
    along = frame.to_world(mi.Vector3f(direction.x, direction.y, 0))
    ray = mi.Ray3f(p + _HEIGHT * reach * n, along, reach, 0, mi.Color0f())
    si = scene.ray_intersect(ray, mi.RayFlags.Minimal, coherent=False)
    front = dr.mulsign(mi.Vector3f(si.n), -dr.dot(si.n, along))
    stands = si.is_valid() & (dr.dot(front, n) < SAME_SURFACE_COSINE)
    facing = frame.to_local(front)
    # An obstacle that leans far over is assumed to face the point.
    away = mi.Vector2f(facing.x, facing.y)
    away *= dr.sign(dr.dot(away, direction))
    away = dr.select(dr.squared_norm(away) > 0.01, dr.normalize(away), direction)
    length = dr.select(stands, si.t, dr.inf)
    return length, away, dr.select(stands, si.t * dr.dot(away, direction), dr.inf)


def next_surface(
    scene: mi.Scene, p: mi.Point3f, n: mi.Normal3f, reach: mi.Float
) -> tuple[mi.Float, mi.Vector3f]:
    """The next surface straight along the normals of points on surfaces.

    Returns its distance, world units, (N,), infinite if there is none within ``reach``, (N,), and
    its unit normal on the far side, (N, 3).
    """
    start = _START * reach
    ray = mi.Ray3f(p + start * n, mi.Vector3f(n), reach - start, 0, mi.Color0f())
    si = scene.ray_intersect(ray, mi.RayFlags.Minimal, coherent=False)
    height = dr.select(si.is_valid(), si.t + start, dr.inf)
    facing = dr.mulsign(mi.Vector3f(si.n), dr.dot(si.n, n))
    dr.eval(height, facing)
    return height, facing

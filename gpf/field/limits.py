"""Where Gaussians end: at whatever stands on their surface, lies over it, or is behind it.

Gaussians are often wider than a wall is thick. So each ends at three planes. One is that of the
nearest obstacle on its surface (:mod:`gpf.scene.obstacles`) that hides most of what lies beyond its
plane. The other two lie before the next
surfaces above and below its own, and are tilted like them: there is much light between a lamp and
the cap behind it and none behind the cap, although the lamp's back, the cap and the wall behind it
face nearly the same way, a finger's breadth apart. A point beyond one of the planes does not use
the Gaussian.

Gaussians in media end at the walls around them: at up to three planes on which several of the
surfaces lie that can be seen from the centre. What is smaller than a wall does not end a Gaussian,
because its plane would cut through the air beside it.

The limits of a Gaussian are three planes (a, d): points x of the unfolded space are before one if
a · x < d; a is a unit vector, or 0 where nothing is near. The planes stay where they are if
training moves the Gaussian.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.loops import loops_traced_once
from gpf.core.structs import from_numpy, to_numpy
from gpf.core.surface_tags import SAME_SURFACE_COSINE
from gpf.field.detail import Detail
from gpf.field.gaussians import Gaussians
from gpf.scene.obstacles import look_along, next_surface

PLANES = 3
"""Number of planes per Gaussian."""

CLEAR = 0.75
"""A Gaussian counts up to this fraction of the way to the next surface above or below its own."""

RAYS = 16
"""Number of directions in which to look for obstacles."""

HIDDEN = 0.5
"""A plane ends a Gaussian if the obstacles hide at least this part of what lies beyond it."""

VIEWS = 48
"""Number of directions in which Gaussians in media look for walls."""

WALL = 3
"""Smallest number of views that end on the same plane, for a wall."""

FLAT = 0.02
"""Largest distance between points of a wall and its plane, as a fraction of how far they are from
the Gaussian."""

_CHUNK = 4096

SURFACE_HEIGHT = 0.35
"""Largest distance of a Gaussian from the plane of the surface, in search radii. Beyond one radius
the limit rises to that of :func:`gpf.core.surface_tags.same_surface`. It is smaller than for
photons, because their radius shrinks and this one does not: a wall behind a lamp may be a thousand
times darker than the lamp's back, and training cannot correct for light that leaks from there."""


def find_limits(scene: mi.Scene, gaussians: Gaussians, detail: Detail) -> np.ndarray | None:
    """The limits of the Gaussians of a field with levels, (N, :data:`PLANES`, 4) float32, or None
    if no Gaussian has any."""
    means = to_numpy(gaussians.means)
    radii = detail.radius / np.float32(2) ** detail.levels_of(means)
    p, n = from_numpy(mi.Point3f, detail.fold(means)), gaussians.normals
    reach = from_numpy(mi.Float, radii)
    # The distance from a surface with the largest allowed tilt to one at the largest height.
    away = reach * (SURFACE_HEIGHT / SAME_SURFACE_COSINE)
    beside = [surface_before(scene, p, side, away) for side in (n, -n)]
    found = np.stack([nearest_obstacles(scene, p, n, reach), *beside], axis=1)
    return unfold(found, means, detail) if found.any() else None


def find_limits_in_space(
    scene: mi.Scene, gaussians: Gaussians, detail: Detail, reach: float
) -> np.ndarray | None:
    """The limits of Gaussians in media, as from :func:`find_limits`.

    Parameters
    ----------
    reach: how far queries look for Gaussians, in search radii.
    """
    means = to_numpy(gaussians.means)
    radii = reach * detail.radius / np.float32(2) ** detail.levels_of(means)
    p, found = detail.fold(means).astype(np.float32), no_limits(len(means))
    for first in range(0, len(p), _CHUNK):
        some = slice(first, first + _CHUNK)
        found[some] = _walls(*_look_around(scene, p[some], radii[some]))
    return unfold(found, means, detail) if found.any() else None


def _look_around(scene: mi.Scene, p: np.ndarray, reach: np.ndarray) -> tuple[np.ndarray, ...]:
    """Where views from points end: offsets, and unit normals away from the points,
    (N, :data:`VIEWS`, 3) each; zeros where nothing is near."""
    k = np.arange(VIEWS) + 0.5
    height, turn = 1 - 2 * k / VIEWS, np.pi * (1 + 5**0.5) * k
    side = np.sqrt(1 - height**2)
    ways = np.stack([side * np.cos(turn), side * np.sin(turn), height], axis=1)
    start = from_numpy(mi.Point3f, np.repeat(p, VIEWS, axis=0))
    ray = mi.Ray3f(start, from_numpy(mi.Vector3f, np.tile(ways, (len(p), 1))))
    ray.maxt = from_numpy(mi.Float, np.repeat(reach, VIEWS))
    si = scene.ray_intersect(ray, mi.RayFlags.Minimal, coherent=False, active=True)
    there = si.is_valid() & (dr.dot(si.n, ray.d) != 0)
    facing = dr.select(there, dr.mulsign(mi.Vector3f(si.n), dr.dot(si.n, ray.d)), 0)
    offset = dr.select(there, si.t * ray.d, 0)
    dr.eval(offset, facing)
    return tuple(to_numpy(v).reshape(len(p), VIEWS, 3) for v in (offset, facing))


def _walls(offset: np.ndarray, facing: np.ndarray) -> np.ndarray:
    """The planes that the most views end on, as limits with distances from the centre."""
    distance = np.einsum("nki,nki->nk", offset, facing)
    far = np.linalg.norm(offset, axis=2)
    # [n, j, k]: whether the end of view k lies on the plane of view j.
    apart = np.einsum("nji,nki->njk", facing, offset) - distance[:, :, None]
    on = (np.abs(apart) <= FLAT * far[:, None, :]) & (far > 0)[:, :, None] & (far > 0)[:, None, :]
    found, rows = no_limits(len(offset)), np.arange(len(offset))
    for plane in range(PLANES):
        best = on.sum(axis=2).argmax(axis=1)
        wall = on[rows, best].sum(axis=1) >= WALL
        found[wall, plane, :3] = facing[rows, best][wall]
        found[wall, plane, 3] = distance[rows, best][wall]
        on &= ~on[rows, best][:, None, :]
    return found


def no_limits(count: int) -> np.ndarray:
    """The limits of ``count`` Gaussians that have none."""
    return np.zeros((count, PLANES, 4), np.float32)


def before(limits: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Whether points (N, K, 3) are before all planes of each Gaussian, (N, K)."""
    found = np.ones(x.shape[:2], bool)
    for k in range(PLANES):
        away, distance = limits[:, k, :3], limits[:, k, 3:]
        free = ~np.any(away, axis=1, keepdims=True)
        found &= free | (np.einsum("ni,nji->nj", away, x) < distance)
    return found


def nearest_obstacles(
    scene: mi.Scene, p: mi.Point3f, n: mi.Normal3f, reach: mi.Float
) -> np.ndarray:
    """The planes of the nearest obstacles around points, perpendicular to the surface there,
    (N, 4) float32: unit vectors away from the points, and distances from them; or zeros.

    A plane goes on where its obstacle, such as the leg of a table, has ended. So most of what lies
    beyond it, within reach, has to be hidden.

    Parameters
    ----------
    p, n: positions and unit normals, world units, (N, 3).
    reach: how far to look for obstacles, world units, (N,).
    """
    if dr.width(p) == 0:
        return np.zeros((0, 4), np.float32)
    count = dr.opaque(mi.UInt32, dr.width(p))
    lane = dr.arange(mi.UInt32, RAYS * dr.width(p))
    owner = lane % count
    place = dr.gather(mi.Point3f, p, owner), dr.gather(mi.Normal3f, n, owner)
    far = dr.gather(mi.Float, mi.Float(reach), owner)
    met = look_along(scene, *place, far, _direction(lane // count))
    dr.eval(met)
    best, found = _nearest(*met, mi.Float(reach), count, dr.arange(mi.UInt32, dr.width(p)))
    return _planes(dr.select(best < reach, mi.Frame3f(n).to_world(found), 0), best)


def _direction(number: mi.UInt32) -> mi.Vector2f:
    sine, cosine = dr.sincos((mi.Float(number) + 0.5) * (2 * np.pi / RAYS))
    return mi.Vector2f(cosine, sine)


@loops_traced_once
@dr.syntax
def _nearest(  # type: ignore[no-untyped-def]
    blocked, away, distance, reach, count, row
) -> tuple[mi.Float, mi.Vector3f]:
    """The distances of the nearest planes that end a Gaussian, (N,), and their directions."""
    best, found = mi.Float(reach), dr.zeros(mi.Vector3f, dr.width(row))
    number = mi.UInt32(0)
    while number < RAYS:
        plane = dr.gather(mi.Vector2f, away, number * count + row)
        at = dr.gather(mi.Float, distance, number * count + row)
        # Areas of the disc in the sectors of the rays: beyond the plane, and hidden there.
        beyond, hidden, other = mi.Float(0), mi.Float(0), mi.UInt32(0)
        while (other < RAYS) & (at < best):
            ends = at / dr.maximum(dr.dot(plane, _direction(other)), 1e-6)
            stops = dr.gather(mi.Float, blocked, other * count + row)
            beyond += dr.maximum(reach**2 - ends**2, 0)
            hidden += dr.maximum(reach**2 - dr.maximum(ends, stops) ** 2, 0)
            other += 1
        nearer = (at < best) & (hidden >= HIDDEN * beyond)
        best = dr.select(nearer, at, best)
        found = dr.select(nearer, mi.Vector3f(plane.x, plane.y, 0), found)
        number += 1
    return best, found


def surface_before(scene: mi.Scene, p: mi.Point3f, n: mi.Normal3f, reach: mi.Float) -> np.ndarray:
    """The planes before the next surfaces straight along the normals, tilted like these surfaces;
    in the same form as from :func:`nearest_obstacles`."""
    height, facing = next_surface(scene, p, n, reach)
    found = dr.select(height < dr.inf, facing, 0)
    return _planes(found, CLEAR * height * dr.dot(facing, n))


def _planes(away: mi.Vector3f, distance: mi.Float) -> np.ndarray:
    planes = np.column_stack([to_numpy(away), distance.numpy()]).astype(np.float32)
    planes[~planes[:, :3].any(axis=1)] = 0
    return planes


def unfold(limits: np.ndarray, means: np.ndarray, detail: Detail | None) -> np.ndarray:
    """Limits of the unfolded space, from limits whose d is a distance from the Gaussian's centre in
    world units; ``means``: centres in the unfolded space, (N, 3)."""
    found = np.array(limits)
    found[:, :, 3] *= _scales(means, detail)
    found[:, :, 3] += _own(found, means)
    return found


def fold(limits: np.ndarray, means: np.ndarray, detail: Detail | None) -> np.ndarray:
    """The inverse of :func:`unfold`."""
    found = np.array(limits)
    found[:, :, 3] -= _own(found, means)
    found[:, :, 3] /= _scales(means, detail)
    return found


def _own(limits: np.ndarray, means: np.ndarray) -> np.ndarray:
    """What d would be if all planes were at the centres, (N, PLANES)."""
    return np.einsum("nki,ni->nk", limits[:, :, :3], means)


def _scales(means: np.ndarray, detail: Detail | None) -> np.ndarray:
    levels = np.zeros(len(means)) if detail is None else detail.levels_of(means)
    return np.asarray(2.0**levels, np.float32)[:, None]

"""Where Gaussians end: at what stands on their surface, lies over it, or is behind it.

Gaussians are often wider than a wall is thick. So each ends at a plane: that of the nearest
obstacle (:mod:`gpf.scene.obstacles`). And it ends before the next surfaces over and under its own:
between a lamp and the cap behind it there is much light, behind the cap none, although both are
surfaces that face the same way, a finger's breadth from each other. A point that is beyond one of
these does not use the Gaussian.

The limits of a Gaussian are six numbers: a, d, top, bottom. Points x of the unfolded space are
before the plane if a · x < d; a is a unit vector, or 0 without an obstacle. And with the Gaussian's
normal n, bottom < n · x < top; where there is no other surface, these are farther away than any
query looks. All of them stay where they are if training moves the Gaussian.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.structs import from_numpy, to_numpy
from gpf.field.detail import Detail
from gpf.field.gaussians import Gaussians
from gpf.scene.obstacles import clear_height, look_along

RAYS = 16
"""Directions in which obstacles are looked for."""

SURFACE_HEIGHT = 0.35
"""Largest distance of a Gaussian from the plane of the surface, in search radii. Beyond one radius
the limit rises to that of :func:`gpf.core.surface_tags.same_surface`. It is smaller than for
photons, because their radius shrinks and this one does not: a wall behind a lamp may be a thousand
times darker than the lamp's back, and training cannot correct for light that leaks from there."""

_FREE = 8.0
"""Search radii up to which a Gaussian counts over and under its surface where nothing else is."""

_CLEAR = 0.75
"""The part of the way to the next surface, over or under its own, for which a Gaussian counts."""


def find_limits(scene: mi.Scene, gaussians: Gaussians, detail: Detail) -> np.ndarray | None:
    """The limits of the Gaussians of a field with levels, (N, 6) float32; None if no Gaussian has
    any."""
    means = to_numpy(gaussians.means)
    radii = detail.radius / np.float32(2) ** detail.levels_of(means)
    p, n = from_numpy(mi.Point3f, detail.fold(means)), gaussians.normals
    reach = from_numpy(mi.Float, radii)
    planes = nearest_obstacles(scene, p, n, reach)
    sides = [clear_height(scene, p, side, SURFACE_HEIGHT * reach).numpy() for side in (n, -n)]
    if not (planes[:, :3].any() or np.isfinite(sides).any()):
        return None
    heights = [np.where(np.isfinite(side), _CLEAR * side, _FREE * radii) for side in sides]
    found = np.column_stack([planes, heights[0], -heights[1]])
    return unfold(found, means, to_numpy(n), detail)


def no_limits(gaussians: Gaussians, radius: float) -> np.ndarray:
    """The limits of Gaussians that have none, (N, 6); ``radius``: of the search."""
    means, normals = to_numpy(gaussians.means), to_numpy(gaussians.normals)
    free = _FREE * radius
    found = np.tile(np.array([0, 0, 0, 0, free, -free], np.float32), (len(means), 1))
    return unfold(found, means, normals, None)


def nearest_obstacles(
    scene: mi.Scene, p: mi.Point3f, n: mi.Normal3f, reach: mi.Float
) -> np.ndarray:
    """The planes of the nearest obstacles around points on surfaces, upright on the surface,
    (N, 4) float32: unit vectors away from the points, and distances from them; or zeros.

    Parameters
    ----------
    p, n: positions and unit normals, world units, (N, 3).
    reach: how far away obstacles are looked for, world units, (N,).
    """
    best, found = mi.Float(reach), dr.zeros(mi.Vector3f, dr.width(p))
    frame = mi.Frame3f(n)
    for number in range(RAYS):
        sine, cosine = dr.sincos(dr.opaque(mi.Float, (number + 0.5) * 2 * np.pi / RAYS))
        met = look_along(scene, p, n, reach, mi.Vector2f(cosine, sine))
        nearer = met.stands & (met.distance < best)
        best = dr.select(nearer, met.distance, best)
        found = dr.select(nearer, frame.to_world(mi.Vector3f(met.away.x, met.away.y, 0)), found)
        dr.eval(best, found)
    planes = np.column_stack([to_numpy(found), best.numpy()]).astype(np.float32)
    planes[~planes[:, :3].any(axis=1)] = 0
    return planes


def unfold(
    limits: np.ndarray, means: np.ndarray, normals: np.ndarray, detail: Detail | None
) -> np.ndarray:
    """Limits whose d, top and bottom are distances from the Gaussians' centres, world units, as
    limits of the unfolded space, (N, 6); ``means``: centres there, (N, 3)."""
    found = np.array(limits)
    found[:, 3:] *= _scales(means, detail)
    found[:, 3:] += _own(found, means, normals)
    return found


def fold(
    limits: np.ndarray, means: np.ndarray, normals: np.ndarray, detail: Detail | None
) -> np.ndarray:
    """The inverse of :func:`unfold`."""
    found = np.array(limits)
    found[:, 3:] -= _own(found, means, normals)
    found[:, 3:] /= _scales(means, detail)
    return found


def _own(limits: np.ndarray, means: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """What d, top and bottom would be if all of them were at the centres, (N, 3)."""
    across = np.einsum("ni,ni->n", limits[:, :3], means)
    height = np.einsum("ni,ni->n", normals, means)
    return np.column_stack([across, height, height])


def _scales(means: np.ndarray, detail: Detail | None) -> np.ndarray:
    levels = np.zeros(len(means)) if detail is None else detail.levels_of(means)
    return np.asarray(2.0**levels, np.float32)[:, None]

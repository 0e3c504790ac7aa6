"""Where Gaussians end: at what stands on their surface.

Gaussians are often wider than a wall is thick. So each ends at a plane: that of the nearest
obstacle (:mod:`gpf.scene.obstacles`). A point beyond the plane does not use it.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.structs import from_numpy, to_numpy
from gpf.field.detail import Detail
from gpf.field.gaussians import Gaussians
from gpf.scene.obstacles import look_along

RAYS = 16
"""Directions in which obstacles are looked for."""


def find_limits(scene: mi.Scene, gaussians: Gaussians, detail: Detail) -> np.ndarray | None:
    """The planes at which the Gaussians of a field with levels end, (N, 4) float32; None if there
    is no obstacle anywhere.

    A plane (a, d) has a unit vector a; points x of the unfolded space are before it if a · x < d.
    Where a is 0, there is no obstacle.
    """
    means = to_numpy(gaussians.means)
    reach = detail.radius / np.float32(2) ** detail.levels_of(means)
    p = from_numpy(mi.Point3f, detail.fold(means))
    planes = nearest_obstacles(scene, p, gaussians.normals, from_numpy(mi.Float, reach))
    return unfold(planes, means, detail) if planes[:, :3].any() else None


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


def unfold(planes: np.ndarray, means: np.ndarray, detail: Detail | None) -> np.ndarray:
    """Planes at distances from the Gaussians' centres, world units, as planes of the unfolded
    space, (N, 4); ``means``: centres there, (N, 3)."""
    found = np.array(planes)
    found[:, 3] *= _scales(means, detail)
    found[:, 3] += np.einsum("ni,ni->n", found[:, :3], means)
    return found


def fold(planes: np.ndarray, means: np.ndarray, detail: Detail | None) -> np.ndarray:
    """The inverse of :func:`unfold`."""
    found = np.array(planes)
    found[:, 3] -= np.einsum("ni,ni->n", found[:, :3], means)
    found[:, 3] /= _scales(means, detail)
    return found


def _scales(means: np.ndarray, detail: Detail | None) -> np.ndarray:
    levels = np.zeros(len(means)) if detail is None else detail.levels_of(means)
    return np.asarray(2.0**levels, np.float32)

"""Many camera walks that begin with the same ray."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.camera.visible_points import follow
from gpf.core.structs import VisiblePoints, to_numpy
from tests.furnace import Scene, rgb

MIRROR = {"type": "conductor", "material": "none", "specular_reflectance": rgb(0.9, 0.6, 0.3)}


GLASS = {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}


def walk(
    scene: Scene,
    origin: tuple[float, float, float],
    target: tuple[float, float, float],
    count: int = 20_000,
    seed: int = 1,
    **options: int | bool | None,
) -> VisiblePoints:
    """``count`` walks that begin with the same ray."""
    loaded = mi.load_dict({"type": "scene"} | scene)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, count)
    d = np.subtract(target, origin) / np.linalg.norm(np.subtract(target, origin))
    ray = mi.Ray3f(mi.Point3f(*origin), mi.Vector3f(*d.tolist()))
    ray = dr.gather(mi.Ray3f, ray, dr.zeros(mi.UInt32, count))
    points, way, _ = follow(loaded, sampler, ray, **options)
    dr.eval(points, way)
    points.share = way.weight
    return points


def spread(value: object, count: int = 20_000) -> np.ndarray:
    """Per lane, also where all lanes are the same."""
    array = to_numpy(value).astype(np.float64)
    return np.broadcast_to(array, (count, *array.shape[1:]))


def is_valid(points: VisiblePoints, count: int = 20_000) -> np.ndarray:
    return spread(points.valid, count).astype(bool)

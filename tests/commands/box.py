"""A field that has E = 1 on all surfaces of a scene, without a fit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mitsuba as mi
import numpy as np

from gpf.core.structs import to_numpy
from gpf.field.field import GaussianPhotonField
from gpf.field.settings import FieldSettings
from gpf.scene.bounds import scene_bounds
from tests.plain_field import flat_gaussians, to_device

SOURCE = Path(__file__).parents[2] / "scenes" / "cornell_box"


def box_field(scene: mi.Scene, count: int = 3000) -> GaussianPhotonField:
    """Gaussians where random rays from inside the Cornell Box hit its surfaces."""
    rng = np.random.default_rng(0)
    direction = rng.normal(size=(3, count))
    direction /= np.linalg.norm(direction, axis=0)
    origin = rng.uniform(-0.9, 0.9, (3, count))
    ray = mi.Ray3f(mi.Point3f(origin), mi.Vector3f(direction))
    si = scene.ray_intersect(ray)
    hit = np.array(si.is_valid())
    normal = to_numpy(mi.Vector3f(si.n))[hit]
    side = np.sign(-(normal * direction.T[hit]).sum(1, keepdims=True))
    g = flat_gaussians(to_numpy(si.p)[hit], np.ones((hit.sum(), 3)), size=0.2)
    g = replace(g, normals=normal * side)
    return GaussianPhotonField(to_device(g), FieldSettings(search_radius=0.3), scene_bounds(scene))

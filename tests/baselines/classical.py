"""Tasks in analytic scenes, and how far an image is from what is known of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from baselines.protocol import Task
from gpf.core.structs import from_numpy
from gpf.scene.sensors import make_sensor
from gpf.scene.views import View
from tests.furnace import Scene, diffuse, floor, point_light

SIZE = (8, 6)

# From within the furnace, and from above the floor.
INSIDE = View(name="inside", origin=(0.3, 0.2, 0.1), target=(1, 0.5, 0.4), up=(0, 0, 1), fov=60)
ABOVE = View(name="above", origin=(0.3, -2, 1.5), target=(0.1, 0.2, 0), up=(0, 0, 1), fov=35)

ALBEDO, LIGHT, INTENSITY = (0.8, 0.5, 0.2), (0.5, 0.4, 0.9), 3.0


def task_for(scene: Scene, size: tuple[int, int] = SIZE, **more: Any) -> Task:
    """A task in a scene that is given as a dictionary."""
    fields = {
        "name": "analytic",
        "scene": mi.load_dict(scene),
        "file": Path("scene.xml"),
        "size": size,
        "exposure": 1.0,
        "training": (),
        "rr_depth": 5,
        "seed": 3,
        "state": Path("state"),
    }
    return Task(**fields | more)


def lit_floor(**objects: Scene) -> Scene:
    """A floor of three colours' albedo under a point, with room for objects in between."""
    scene = {
        "type": "scene",
        "floor": floor(diffuse(*ALBEDO)),
        "light": point_light(LIGHT, INTENSITY),
    }
    return scene | objects


def floor_radiance(view: View, size: tuple[int, int] = SIZE, grid: int = 8) -> np.ndarray:
    """L = ρ/π I cos θ / d² of the floor, means over pixels from so many rows of rays, (H, W, 3)."""
    width, height = size
    x, y = np.meshgrid(*((np.arange(n * grid) + 0.5) / (n * grid) for n in size))
    place = from_numpy(mi.Point2f, np.stack([x.ravel(), y.ravel()], axis=1))
    ray, _ = make_sensor(view, *size).sample_ray(mi.Float(0), mi.Float(0), place, mi.Point2f(0))
    p = (ray.o + ray.d * (-ray.o.z / ray.d.z)).numpy().T
    to_light = np.array(LIGHT) - p
    distance2 = (to_light**2).sum(1)
    irradiance = INTENSITY * to_light[:, 2] / distance2**1.5
    means = irradiance.reshape(height, grid, width, grid).mean((1, 3))
    return means[..., None] * np.array(ALBEDO) / np.pi


def pane() -> Scene:
    """A plate of glass right above the floor, wider than what is looked at."""
    to_world = mi.ScalarTransform4f().translate([0, 0, 0.3]).scale([2.5, 2.5, 0.02])
    return {"type": "cube", "to_world": to_world, "bsdf": {"type": "dielectric", "int_ior": 1.5}}

"""Scenes with a known light, and fields that have it on all of their surfaces."""

from __future__ import annotations

from collections.abc import Callable

import mitsuba as mi
import numpy as np

from gpf.baking.atlas import Atlas
from gpf.baking.surfaces import Surface, read_surfaces
from gpf.core.structs import from_numpy
from gpf.field.field import GaussianPhotonField
from gpf.field.gaussians import Gaussians
from gpf.field.settings import FieldSettings
from gpf.scene.bounds import scene_bounds

Light = Callable[[np.ndarray], np.ndarray]
"""Irradiance at positions, (N, 3)."""

DIFFUSE = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.5, 0.4, 0.3]}}
INTENSITY = np.array([3.0, 2.0, 1.0])
LAMP = np.array([0.5, 0.3, 2.0])


def solid_scene() -> mi.Scene:
    """A box and a ball in the air."""
    to_world = mi.ScalarTransform4f().rotate([1 / 3, 2 / 3, 2 / 3], 30).scale([0.4, 0.7, 0.5])
    return mi.load_dict(
        {
            "type": "scene",
            "box": {"type": "cube", "to_world": to_world, "bsdf": DIFFUSE},
            "ball": {"type": "sphere", "center": [2, 0.5, 0], "radius": 0.6, "bsdf": DIFFUSE},
            "sky": {"type": "constant"},
        }
    )


def lamp_scene(**more: dict) -> mi.Scene:
    """A point light over a floor and a ball beside it."""
    return mi.load_dict({"type": "scene", **lamp_scene_parts(), **more})


def lamp_scene_parts() -> dict[str, dict]:
    ground = mi.ScalarTransform4f().scale([1.5, 1, 1])
    intensity = {"type": "rgb", "value": INTENSITY.tolist()}
    return {
        "floor": {"type": "rectangle", "to_world": ground, "bsdf": DIFFUSE},
        "ball": {"type": "sphere", "center": [4, 0.3, 2], "radius": 0.6, "bsdf": DIFFUSE},
        "lamp": {"type": "point", "position": LAMP.tolist(), "intensity": intensity},
    }


def from_lamp(p: np.ndarray, n: np.ndarray) -> np.ndarray:
    """E = I cos / r²."""
    way = LAMP - p
    distance = np.linalg.norm(way, axis=1, keepdims=True)
    cosine = np.maximum((way / distance * n).sum(axis=1, keepdims=True), 0)
    return INTENSITY * cosine / distance**2


def field_with(scene: mi.Scene, light: Light, count: int = 4000, **more) -> GaussianPhotonField:
    """A field with this light on the fronts of all surfaces."""
    rng = np.random.default_rng(0)
    p, n = (np.concatenate(part) for part in zip(*places(scene, count, rng), strict=True))
    gaussians = Gaussians(
        means=from_numpy(mi.Point3f, p),
        log_scales=from_numpy(mi.Vector3f, np.full((len(p), 3), np.log(0.06))),
        quats=from_numpy(mi.Quaternion4f, np.tile([0.0, 0, 0, 1], (len(p), 1))),
        irradiance=from_numpy(mi.Color3f, light(p)),
        normals=from_numpy(mi.Normal3f, n),
    )
    settings = FieldSettings(search_radius=0.15, **more)
    return GaussianPhotonField(gaussians, settings, scene_bounds(scene))


def places(scene: mi.Scene, count: int, rng: np.random.Generator) -> list:
    """Random points and normals on each surface."""
    surfaces, _ = read_surfaces(scene)
    return [surface.at(*on_triangles(surface, count // len(surfaces), rng)) for surface in surfaces]


def on_triangles(
    surface: Surface, count: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Triangles and barycentric coordinates, uniform over the area."""
    a, b, c = surface.corners.transpose(1, 0, 2)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return rng.choice(len(area), count, p=area / area.sum()), rng.dirichlet([1, 1, 1], count)


def look_up(image: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Bilinear: texel centres are at halves, and v = 0 is at the top."""
    height, width = image.shape[:2]
    place = uv * [width, height] - 0.5
    low = np.floor(place).astype(int)
    x, y = (place - low).T[..., None]
    columns = np.clip(np.stack([low[:, 0], low[:, 0] + 1]), 0, width - 1)
    rows = np.clip(np.stack([low[:, 1], low[:, 1] + 1]), 0, height - 1)
    upper, lower = ((1 - x) * image[row, columns[0]] + x * image[row, columns[1]] for row in rows)
    return (1 - y) * upper + y * lower


def looked_up(atlas: Atlas, image: np.ndarray, name: str, faces, weights) -> np.ndarray:
    """What a map has at points of a surface."""
    chart = next(chart for chart in atlas.charts if chart.surface.name == name)
    return look_up(image, np.einsum("pk,pki->pi", weights, chart.uv[chart.faces[faces]]))

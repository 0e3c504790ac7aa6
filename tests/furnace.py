"""Analytic scenes: their right answer is known, or follows from Mitsuba's ``path`` at once.

All scenes are dictionaries for ``mi.load_dict``; the integrator is added by whoever renders.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.ndimage import maximum_filter, minimum_filter

from gpf.core.structs import from_numpy

Scene = dict[str, Any]


def rgb(*value: float) -> Scene:
    """A colour; one number is a grey."""
    return {"type": "rgb", "value": list(value) if len(value) == 3 else [value[0]] * 3}


def diffuse(*albedo: float) -> Scene:
    return {"type": "diffuse", "reflectance": rgb(*albedo)}


def two_sided(*albedo: float) -> Scene:
    return {"type": "twosided", "material": diffuse(*albedo)}


def bitmap(values: np.ndarray, **options: Any) -> Scene:
    """A texture with the given linear values, (H, W, 3)."""
    pixels = mi.Bitmap(np.ascontiguousarray(values, dtype=np.float32))
    return {"type": "bitmap", "bitmap": pixels, "raw": True, **options}


def facing(origin: Any, target: Any) -> mi.ScalarTransform4f:
    """A frame at ``origin`` whose z axis points at ``target``, upright where it can be."""
    level = [t != o for o, t in zip(origin[:2], target[:2], strict=True)]
    up = (0, 0, 1) if any(level) else (0, 1, 0)
    return mi.ScalarTransform4f().look_at(origin, target, up)


def rectangle(
    origin: Any, target: Any, width: float, height: float, bsdf: Scene, **more: Any
) -> Scene:
    """A rectangle at ``origin`` whose front looks at ``target``."""
    scale = mi.ScalarTransform4f().scale([width / 2, height / 2, 1])
    to_world = facing(origin, target) @ scale
    return {"type": "rectangle", "to_world": to_world, "bsdf": bsdf, **more}


def floor(bsdf: Scene, z: float = 0, size: float = 6) -> Scene:
    """A square in the plane ``z``, seen from above."""
    to_world = mi.ScalarTransform4f().translate([0, 0, z]).scale([size / 2, size / 2, 1])
    return {"type": "rectangle", "to_world": to_world, "bsdf": bsdf}


def smooth_floor(bsdf: Scene, normals: np.ndarray) -> mi.Mesh:
    """A flat square of 6 in the plane 0 whose four corners have shading normals (4, 3)."""
    properties = mi.Properties()
    properties["material"] = mi.load_dict(bsdf)
    mesh = mi.Mesh("floor", 4, 2, has_vertex_normals=True, props=properties)
    unit = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = [-3, -3, 0, 3, -3, 0, 3, 3, 0, -3, 3, 0]
    parameters["vertex_normals"] = unit.ravel().tolist()
    parameters["faces"] = [0, 1, 2, 0, 2, 3]
    parameters.update()
    return mesh


def room(bsdf: Scene, half: tuple[float, float, float] = (1.5, 1.0, 0.8)) -> Scene:
    """A closed box around the origin, seen from inside."""
    to_world = mi.ScalarTransform4f().scale(list(half))
    return {"type": "cube", "flip_normals": True, "to_world": to_world, "bsdf": bsdf}


def point_light(position: Any, *intensity: float) -> Scene:
    return {"type": "point", "position": list(position), "intensity": rgb(*intensity)}


def lamp(
    origin: Any, target: Any, size: float, *radiance: float, bsdf: Scene | None = None
) -> Scene:
    """A square lamp that reflects nothing unless a BSDF is given."""
    light = {"type": "area", "radiance": rgb(*radiance)}
    return rectangle(origin, target, size, size, bsdf or diffuse(0), emitter=light)


def camera(
    origin: Any,
    target: Any,
    fov: float = 40,
    size: tuple[int, int] = (8, 6),
    **film: Any,
) -> Scene:
    """A pinhole camera with a box filter, so that pixels are independent of each other."""
    return {
        "type": "perspective",
        "fov": fov,
        "near_clip": 1e-3,
        "to_world": facing(origin, target),
        "film": {
            "type": "hdrfilm",
            "width": size[0],
            "height": size[1],
            "pixel_format": "rgb",
            "rfilter": {"type": "box"},
        }
        | film,
    }


def furnace(light: str, albedo: float = 0.5, size: tuple[int, int] = (8, 6)) -> Scene:
    """pbrt's furnace: inside a unit sphere of albedo ½ the radiance is 1 in every direction.

    ``light`` is ``point`` (in the centre: ρ E/π = ½ and all further bounces add up to as much) or
    ``area`` (the sphere itself emits ½).
    """
    sphere = {"type": "sphere", "radius": 1, "flip_normals": True, "bsdf": diffuse(albedo)}
    scene = {"type": "scene", "sensor": camera((0.3, 0.2, 0.1), (1, 0.5, 0.4), 60, size)}
    if light == "point":
        intensity = np.pi * (1 - albedo) / albedo
        return scene | {"sphere": sphere, "light": point_light((0, 0, 0), intensity)}
    sphere["emitter"] = {"type": "area", "radiance": rgb(1 - albedo)}
    return scene | {"sphere": sphere}


def cornell_box(size: tuple[int, int] = (48, 40), glass: bool = False) -> Scene:
    """Mitsuba's Cornell box; on request with a glass sphere in place of the small box."""
    scene: Scene = mi.cornell_box()
    scene["sensor"]["film"] |= {
        "width": size[0],
        "height": size[1],
        "rfilter": {"type": "box"},
        "pixel_format": "rgb",
    }
    if glass:
        del scene["small-box"]
        scene["glass"] = {
            "type": "sphere",
            "center": [0.335, -0.64, 0.38],
            "radius": 0.35,
            "bsdf": {"type": "dielectric", "int_ior": 1.5},
        }
    return scene


def studio(floor_bsdf: Scene, size: tuple[int, int] = (24, 16), **objects: Scene) -> Scene:
    """A floor, a back wall and a lamp behind the camera; of all edges, only one is in view."""
    return {
        "type": "scene",
        "sensor": camera((0.2, -3, 2), (0, 0.3, 0.1), 30, size),
        "floor": floor(floor_bsdf),
        "wall": rectangle((0, 1.2, 0), (0, 0, 0), 6, 6, diffuse(0.7, 0.5, 0.3)),
        "lamp": lamp((1.2, -2.4, 3), (0, 0.2, 0), 1.2, 10, 8, 6),
    } | objects


def render(scene: Scene, integrator: Scene, spp: int, seeds: int, first: int = 0) -> np.ndarray:
    """Independent images of a scene, (seeds, H, W, 3); for ``sppm``, ``spp`` is passes."""
    loaded = mi.load_dict(scene | {"integrator": integrator})
    images = [mi.render(loaded, spp=spp, seed=first + k).numpy() for k in range(seeds)]
    return np.stack(images).astype(np.float64)


def sppm(photons: int = 100_000, radius: float = 0.03, **more: Any) -> Scene:
    return {"type": "sppm", "photons_per_pass": photons, "initial_radius": radius} | more


def interior(scene: Scene) -> np.ndarray:
    """Pixels that see one smooth surface, as all their neighbours do, and no lamp, (H, W)."""
    kinds = {"type": "aov", "aovs": "shape:shape_index,normal:sh_normal"}
    seen = render(scene, kinds | {"lamps": {"type": "path", "max_depth": 1}}, 1, 8)
    around = (8, 3, 3, 1)
    spread = maximum_filter(seen, around).max(0) - minimum_filter(seen, around).min(0)
    lamps, shape, normal = spread[..., :3], spread[..., 3], spread[..., 4:7]
    dark = seen[..., :3].max((0, 3)) == 0
    return dark & (lamps.max(2) == 0) & (shape == 0) & (normal.max(2) < 0.5)


def block_means(images: np.ndarray, block: int, mask: np.ndarray) -> np.ndarray:
    """Means over the masked pixels of square blocks, (seeds, blocks, 3); sparse blocks left out."""
    k, h, w, c = images.shape
    tiles = (images * mask[..., None]).reshape(k, h // block, block, w // block, block, c)
    share = mask.reshape(h // block, block, w // block, block).mean((1, 3))
    filled = share >= 0.25
    return tiles.mean((2, 4))[:, filled] / share[filled][:, None]


def z_scores(a: np.ndarray, b: np.ndarray, bias: float = 0) -> np.ndarray:
    """How many standard errors two sets of independent images lie apart, value by value.

    ``bias`` is a relative difference that is granted beforehand.
    """
    error = np.sqrt(a.var(0, ddof=1) / len(a) + b.var(0, ddof=1) / len(b))
    apart = np.maximum(np.abs(a.mean(0) - b.mean(0)) - bias * np.abs(b.mean(0)), 0)
    return apart / np.maximum(error, 1e-12)


def interaction(wi: np.ndarray) -> mi.SurfaceInteraction3f:
    """A surface in the xy plane, seen from the directions ``wi``, (N, 3)."""
    si = dr.zeros(mi.SurfaceInteraction3f, len(wi))
    si.wi = from_numpy(mi.Vector3f, wi)
    si.n = mi.Normal3f(0, 0, 1)
    si.sh_frame = mi.Frame3f(mi.Normal3f(0, 0, 1))
    si.uv = mi.Point2f(0.5)
    si.t = mi.Float(1)
    return si

"""A scene with one surface of each kind that a file can show, and a field with known light."""

from __future__ import annotations

from pathlib import Path

import mitsuba as mi
import numpy as np
from PIL import Image

from gpf.baking.atlas import unwrap
from gpf.baking.bake import LightMaps, bake_maps, surfaces_to_bake
from gpf.baking.gltf import Stage
from gpf.baking.surfaces import read_specular_surfaces
from gpf.core.structs import to_numpy
from gpf.field.field import GaussianPhotonField
from gpf.field.lights import FieldLights
from gpf.scene.light_groups import LightGroups
from gpf.scene.views import View
from tests.baking.known_light import field_with

VIEWS = (
    View(name="front", origin=(0.1, 1.2, 3.6), target=(0, 0.6, 0), fov=50),
    View(name="side", origin=(-1.5, 1.6, 2.2), target=(0.2, 0.4, -0.3), fov=60),
)
ASPECT, EXPOSURE = 1.25, 1.1
GOLD = {"type": "roughconductor", "material": "Au", "alpha": 0.09}


def light(p: np.ndarray) -> np.ndarray:
    return 1.5 + np.sin(3 * p[:, [0]] + [0, 1, 2]) * np.cos(2 * p[:, [1]] - p[:, [2]])


def showroom(folder: Path, finer: int = 1) -> mi.Scene:
    """A floor with an image, a wall with squares, things of plastic, gold and glass, a lamp.

    ``finer``: pixels of the image along each edge of one of its squares.
    """
    steps = np.mgrid[0:12, 0:16].transpose(1, 2, 0) * [255 / 11, 255 / 15]
    pixels = np.concatenate([steps, 90 + 0 * steps[..., :1]], axis=2).astype(np.uint8)
    pixels = pixels.repeat(finer, axis=0).repeat(finer, axis=1)
    Image.fromarray(pixels).save(folder / "floor.png")
    place = mi.ScalarTransform4f
    tiles = {
        "type": "bitmap",
        "filename": str(folder / "floor.png"),
        "to_uv": place().scale([2, 3, 1]),
    }
    squares = {
        "type": "checkerboard",
        "color0": {"type": "rgb", "value": [0.8, 0.3, 0.2]},
        "to_uv": place().scale([4, 4, 1]),
    }
    white = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": 0.7}}
    upright = place().translate([0, 1.5, -1.5]).scale(1.5)
    overhead = place().translate([0, 2.6, 0]).rotate([1, 0, 0], 90).scale([0.5, 0.3, 1])
    return mi.load_dict(
        {
            "type": "scene",
            "floor": {
                "type": "rectangle",
                "to_world": place().rotate([1, 0, 0], -90).scale(1.5),
                "bsdf": {"type": "diffuse", "reflectance": tiles},
            },
            "wall": {
                "type": "rectangle",
                "to_world": upright,
                "bsdf": {"type": "diffuse", "reflectance": squares},
            },
            "stand": {
                "type": "cube",
                "to_world": place().translate([-0.8, 0.3, -0.8]).scale(0.3),
                "bsdf": white,
            },
            "toy": {
                "type": "sphere",
                "center": [-0.3, 0.35, 0.6],
                "radius": 0.35,
                "bsdf": {"type": "roughplastic", "alpha": 0.09, "diffuse_reflectance": 0.4},
            },
            "ingot": {
                "type": "cube",
                "to_world": place().translate([0.9, 0.25, -0.5]).scale(0.25),
                "bsdf": GOLD,
            },
            "marble": {
                "type": "sphere",
                "center": [0.7, 0.3, 0.7],
                "radius": 0.3,
                "bsdf": {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0},
            },
            "lamp": {
                "type": "rectangle",
                "to_world": overhead,
                "bsdf": white,
                "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [1.5, 1.2, 0.9]}},
            },
            "sky": {"type": "constant", "radiance": {"type": "rgb", "value": [0.1, 0.2, 0.3]}},
        }
    )


def grouped_field(scene: mi.Scene) -> GaussianPhotonField:
    """A field of this light; a part that varies is the lamp's, the rest the sky's."""
    field = field_with(scene, light)
    total = to_numpy(field.gaussians.irradiance)
    share = (0.5 + 0.4 * np.sin(4 * to_numpy(field.gaussians.means)[:, :1])).astype(np.float32)
    groups = LightGroups.each(scene)
    parts = {"lamp": share * total, "sky": (1 - share) * total}
    field.lights = FieldLights(groups, np.stack([parts[name] for name in groups.names]))
    return field


def bake_showroom(scene: mi.Scene, field: GaussianPhotonField, size: int) -> tuple:
    """The baked light, what files show, and the emitters of each group."""
    surfaces, _ = surfaces_to_bake(scene)
    baked: LightMaps = bake_maps(scene, field, unwrap(surfaces, size), samples=1)
    stage = Stage(scene, baked.atlas, read_specular_surfaces(scene), VIEWS, ASPECT)
    groups = field.lights.groups
    return baked, stage, dict(zip(groups.names, groups.members, strict=True))

"""Small scenes, each with a lamp or a material, as Mitsuba and other renderers are to show them."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np

from gpf.scene.views import View
from tests.furnace import Scene, bitmap, diffuse, rectangle, rgb

SIZE = (72, 48)
VIEW = View(name="a", origin=(0.4, -6, 3), target=(0, 0, 0.7), up=(0, 0, 1), fov=38, fov_axis="x")


def at(*steps: tuple[str, Any]) -> mi.ScalarTransform4f:
    """Scale, turn and move: the steps in their order in the scene file."""
    found = mi.ScalarTransform4f()
    for kind, value in reversed(steps):
        found = found @ (
            mi.ScalarTransform4f().rotate(*value)
            if kind == "rotate"
            else getattr(mi.ScalarTransform4f(), kind)(value)
        )
    return found


def picture(rows: int = 5, columns: int = 8) -> Scene:
    """A texture without symmetry."""
    v, u = np.mgrid[0:rows, 0:columns]
    red, green = 0.1 + 0.8 * u / columns, 0.9 - 0.7 * v / rows
    pixels = np.stack([red, green, 0.2 + 0.5 * ((u + 2 * v) % 3 == 0)], axis=-1)
    return bitmap(pixels)


def looking(origin: Any, target: Any, up: Any = (0, 0, 1)) -> mi.ScalarTransform4f:
    return mi.ScalarTransform4f().look_at(list(origin), list(target), list(up))


def stage(**more: Any) -> Scene:
    """A floor and a wall, a box and a ball; more comes with its own light."""
    box = at(("scale", 0.5), ("rotate", ((0, 0, 1), 25)), ("translate", (-1, 0.4, 0.5)))
    found = {
        "type": "scene",
        "floor": rectangle((0, 0, 0), (0, 0, 1), 8, 8, diffuse(0.6, 0.5, 0.4)),
        "wall": rectangle((0, 2.5, 2), (0, -1, 0), 8, 6, diffuse(0.3, 0.5, 0.6)),
        "box": {"type": "cube", "to_world": box, "bsdf": diffuse(0.7, 0.3, 0.2)},
        "ball": {"type": "sphere", "center": [0.9, 0, 0.6], "radius": 0.6, "bsdf": diffuse(0.5)},
    }
    return found | more


def shining(scale: Any, place: Any, towards: Any, kind: str = "rectangle", **more: Any) -> Scene:
    turned = mi.ScalarTransform4f().look_at(list(place), list(towards), [0.1, 1, 0.3])
    lamp = {"type": "area", "radiance": rgb(20, 15, 10)} | more
    to_world = turned @ mi.ScalarTransform4f().scale(scale)
    return {"type": kind, "to_world": to_world, "bsdf": diffuse(0.2), "emitter": lamp}


SKY = np.random.default_rng(3).uniform(0.2, 1, (8, 16, 3)).astype(np.float32)
SKY[1:4, 3:6] *= (8, 5, 2)
TILTED = at(("rotate", ((1, 0, 0), 70)), ("rotate", ((0, 0, 1), 40)))

LAMPS: dict[str, Any] = {
    "rectangle": lambda: shining((0.8, 0.3, 1), (2, -2, 4), (0, 0, 0.5)),
    "disk": lambda: shining((0.5, 0.5, 1), (-2, -2, 4), (0, 0, 0.5), "disk"),
    "sphere": lambda: {
        "type": "sphere",
        "center": [-1.5, -1.5, 2.5],
        "radius": 0.3,
        "emitter": {"type": "area", "radiance": rgb(20, 15, 30)},
    },
    "box": lambda: shining((0.3, 0.2, 0.1), (0.5, -2, 2.5), (0, 0, 0.5), "cube"),
    "sheared": lambda: {
        "type": "rectangle",
        "to_world": looking((1, -2, 4), (0, 0, 0))
        @ mi.ScalarTransform4f(
            np.array([[1.0, 0.6, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
        ),
        "emitter": {"type": "area", "radiance": rgb(5, 5, 4)},
    },
    "picture": lambda: shining((1, 0.6, 1), (0.3, -1.5, 3), (0, 1, 1), radiance=picture()),
    "point": lambda: {"type": "point", "position": [-1, -2, 3], "intensity": rgb(20, 30, 10)},
    "spot": lambda: {
        "type": "spot",
        "to_world": looking((2, -3, 4), (0, 0, 0.5)),
        "intensity": rgb(50, 60, 30),
        "cutoff_angle": 24.0,
        "beam_width": 8.0,
    },
    "projector": lambda: {
        "type": "projector",
        "to_world": looking((1, -4, 5), (0, 0, 0.5)),
        "irradiance": picture(),
        "scale": 60.0,
        "fov": 40.0,
        "fov_axis": "x",
    },
    "directional": lambda: {
        "type": "directional",
        "direction": [-0.4, 0.7, -1],
        "irradiance": rgb(3, 2, 1),
    },
    "constant": lambda: {"type": "constant", "radiance": rgb(0.5, 0.7, 0.9)},
    "envmap": lambda: {
        "type": "envmap",
        "bitmap": mi.Bitmap(SKY),
        "scale": 0.7,
        "to_world": TILTED,
    },
}
"""Lamps by name."""


def glass(**more: Any) -> Scene:
    return {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0} | more


def both_sides(bsdf: Scene) -> Scene:
    return {"type": "twosided", "bsdf": bsdf}


def board(**more: Any) -> Scene:
    to_uv = at(("scale", (4, 3, 1)), ("rotate", ((0, 0, 1), 20)), ("translate", (0.1, 0.2, 0)))
    colours = {"color0": rgb(0.8, 0.3, 0.1), "color1": rgb(0.1, 0.4, 0.7)}
    return {"type": "checkerboard", "to_uv": to_uv, **colours} | more


def dents() -> Scene:
    v, u = (np.mgrid[0:64, 0:128] + 0.5) / np.array([64, 128])[:, None, None]
    height = 0.5 + 0.25 * np.sin(2 * np.pi * 6 * u) + 0.25 * np.sin(2 * np.pi * 4 * v)
    return bitmap(np.repeat(height[..., None], 3, axis=2))


def slopes() -> Scene:
    v, u = (np.mgrid[0:64, 0:128] + 0.5) / np.array([64, 128])[:, None, None]
    normal = np.stack([0.4 * np.sin(40 * u), 0.3 * np.sin(20 * v) + 0.1, np.ones_like(u)], axis=-1)
    return bitmap(0.5 + 0.5 * normal / np.linalg.norm(normal, axis=-1, keepdims=True))


MATERIALS: dict[str, Any] = {
    "diffuse": lambda: {"type": "diffuse", "reflectance": picture()},
    "checkerboard": lambda: both_sides({"type": "diffuse", "reflectance": board()}),
    "mirror": lambda: {"type": "conductor", "specular_reflectance": rgb(0.9, 0.7, 0.5)},
    "gold": lambda: {"type": "conductor", "material": "Au"},
    "rough_gold": lambda: both_sides({"type": "roughconductor", "material": "Au", "alpha": 0.2}),
    "ggx": lambda: {
        "type": "roughconductor",
        "material": "Cu",
        "alpha": 0.3,
        "distribution": "ggx",
        "specular_reflectance": board(),
    },
    "brushed": lambda: {
        "type": "roughconductor",
        "material": "Al",
        "alpha_u": 0.08,
        "alpha_v": 0.3,
    },
    "glass": glass,
    "tinted": lambda: glass(specular_transmittance=rgb(0.5, 0.9, 0.7)),
    "frosted": lambda: glass(type="roughdielectric", alpha=0.15, distribution="ggx"),
    "pane": lambda: {"type": "thindielectric", "specular_transmittance": rgb(0.9, 0.6, 0.5)},
    "plastic": lambda: {"type": "plastic", "diffuse_reflectance": rgb(0.6, 0.2, 0.1)},
    "nonlinear": lambda: {
        "type": "plastic",
        "diffuse_reflectance": rgb(0.8, 0.5, 0.1),
        "nonlinear": True,
        "int_ior": 1.7,
    },
    "roughplastic": lambda: {
        "type": "roughplastic",
        "diffuse_reflectance": picture(),
        "alpha": 0.2,
        "distribution": "ggx",
    },
    "principled": lambda: {
        "type": "principled",
        "base_color": rgb(0.7, 0.3, 0.2),
        "roughness": 0.5,
        "specular": 0.5,
    },
    "metal": lambda: {
        "type": "principled",
        "base_color": picture(),
        "metallic": 1.0,
        "roughness": 0.3,
    },
    "clear": lambda: {
        "type": "principled",
        "base_color": rgb(0.8, 0.9, 0.7),
        "spec_trans": 1.0,
        "roughness": 0.1,
        "eta": 1.4,
    },
    "coat": lambda: {
        "type": "principled",
        "base_color": rgb(0.1, 0.3, 0.6),
        "roughness": 0.6,
        "clearcoat": 1.0,
        "clearcoat_gloss": 0.9,
    },
    "leaf": lambda: {
        "type": "principledthin",
        "base_color": rgb(0.2, 0.7, 0.3),
        "diff_trans": 1.2,
    },
    "mask": lambda: {"type": "mask", "opacity": 0.4, "bsdf": diffuse(0.7, 0.2, 0.2)},
    "cutout": lambda: {
        "type": "mask",
        "opacity": board(color0=rgb(0), color1=rgb(1)),
        "bsdf": both_sides(diffuse(0.4)),
    },
    "blend": lambda: {
        "type": "blendbsdf",
        "weight": 0.3,
        "first": diffuse(0.8, 0.1, 0.1),
        "second": {"type": "roughconductor", "material": "Ag", "alpha": 0.3},
    },
    "sides": lambda: {"type": "twosided", "front": diffuse(0.8, 0, 0), "back": diffuse(0, 0.8, 0)},
    "dented": lambda: {"type": "bumpmap", "map": dents(), "scale": 0.05, "bsdf": diffuse(0.6)},
    "sloped": lambda: {"type": "normalmap", "normalmap": slopes(), "bsdf": diffuse(0.6)},
    "null": lambda: {"type": "null"},
}
"""Materials by name."""


def shown(bsdf: Scene) -> Scene:
    """A ball, and a sheet seen from both sides, of a material, under a large lamp and a sky."""
    return stage(
        ball={"type": "sphere", "center": [0.9, 0, 0.75], "radius": 0.7, "bsdf": bsdf},
        sheet={
            "type": "rectangle",
            "to_world": at(
                ("scale", 0.6),
                ("rotate", ((1, 0, 0), 80)),
                ("rotate", ((0, 0, 1), 110)),
                ("translate", (-0.6, -1, 0.7)),
            ),
            "bsdf": bsdf,
        },
        lamp=shining((1.2, 1.2, 1), (-1, -3, 5), (0, 0, 0)),
        sky={"type": "constant", "radiance": rgb(0.3, 0.4, 0.5)},
    )


def _box() -> tuple[Scene, View]:
    """A closed room with a window of glass, a ball of gold and one of glass."""
    walls = {
        f"wall_{k}": rectangle(place, (0, 0, 1), 4, 4, diffuse(*colour))
        for k, (place, colour) in enumerate(
            [
                ((0, 0, -1), (0.7, 0.7, 0.7)),
                ((0, 0, 3), (0.7, 0.7, 0.7)),
                ((-2, 0, 1), (0.6, 0.1, 0.1)),
                ((2, 0, 1), (0.1, 0.5, 0.1)),
                ((0, 2, 1), (0.7, 0.7, 0.7)),
                ((0, -2, 1), (0.5, 0.5, 0.5)),
            ]
        )
    }
    balls = {
        "gold": {"type": "sphere", "center": [-0.8, 0.5, -0.4], "radius": 0.6},
        "glass": {"type": "sphere", "center": [0.8, 0, -0.4], "radius": 0.6, "bsdf": glass()},
    }
    balls["gold"]["bsdf"] = MATERIALS["rough_gold"]()
    lamp = shining((0.7, 0.5, 1), (0, 0.2, 2.9), (0, 0.2, 0))
    view = VIEW.model_copy(update={"origin": (0.2, -1.9, 1.2), "target": (0, 0, 0.7), "fov": 80})
    return {"type": "scene", **walls, **balls, "lamp": lamp}, view


def _copies() -> tuple[Scene, View]:
    """Instances, one of them mirrored, seen by a camera with a shift, and painted vertices."""
    group = {
        "type": "shapegroup",
        "id": "group",
        "ball": {"type": "sphere", "radius": 0.3, "bsdf": diffuse(0.8, 0.2, 0.2)},
        "box": {
            "type": "cube",
            "to_world": at(("scale", (0.2, 0.3, 0.4)), ("translate", (0.6, 0, 0))),
            "bsdf": {"type": "diffuse", "reflectance": picture()},
        },
    }
    moved = {"type": "instance", "g": {"type": "ref", "id": "group"}}
    copies = {
        "first": moved | {"to_world": at(("translate", (-1.2, -0.5, 0.6)))},
        "second": moved | {"to_world": at(("scale", (-1, 1, 1)), ("translate", (1.4, -1, 1.4)))},
    }
    view = VIEW.model_copy(update={"shift": (0.1, -0.15)})
    return stage(group=group, **copies, lamp=LAMPS["rectangle"](), sky=LAMPS["constant"]()), view


SCENES: dict[str, Any] = {"box": _box, "copies": _copies}
"""Scenes with their views by name."""

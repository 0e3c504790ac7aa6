"""Small scenes for checking everything that has to work on anybody's scene.

Nothing is tuned to them: where cameras are placed, how long a sample takes in dark places, how good
a field is by default. y is up; lengths are metres. Every scene has one sensor, where a photographer
would stand.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import mitsuba as mi
import numpy as np

from gpf.modelling.meshes import lathe
from scenes.modelling.shapes import (
    BLUE,
    GREEN,
    GREY,
    RED,
    WHITE,
    WOOD,
    Dict,
    box,
    camera,
    lamp,
    rectangle,
    rgb,
    room,
    sphere,
    triangles,
    walls,
)


def closed_room() -> Dict:
    """A furnished room without a window, seen from a corner."""
    scene = room((4, 2.6, 5)) | camera((1.7, 1.6, 2.2), (-0.8, 0.8, -1.2), 60)
    scene |= {
        "lamp": lamp((0, 2.58, 0), (0.5, 0.5), 18),
        "table": box((-0.6, 0.36, -0.8), (0.7, 0.36, 0.45), WOOD),
        "glass": sphere((-0.4, 0.92, -0.8), 0.2, {"type": "dielectric"}),
        "gold": sphere((-0.95, 0.87, -0.7), 0.15, {"type": "roughconductor", "material": "Au"}),
        "shelf": box((1.7, 0.9, -1.6), (0.25, 0.9, 0.6), BLUE),
    }
    return scene


def open_box() -> Dict:
    """A box without a lid on a large dark floor, seen from above and outside."""
    scene = camera((2.1, 2.6, 3.0), (0, 0.3, 0), 36)
    scene |= walls((2, 1, 2), ("left", "right", "back", "front"))
    scene |= {
        "ground": rectangle((0, -0.01, 0), (8, 8), "up", GREY),
        "bottom": rectangle((0, 0, 0), (1, 1), "up", WHITE),
        "lamp": lamp((0.3, 3.5, 0.2), (0.25, 0.25), 60),
        "glass": sphere((0.25, 0.3, 0.2), 0.3, {"type": "dielectric"}),
        "cube": box((-0.45, 0.2, -0.35), (0.2, 0.2, 0.2), RED),
    }
    return scene


def terrace() -> Dict:
    """A terrace with two walls under a sky with a sun."""
    scene = camera((3.6, 1.7, 4.2), (0, 0.7, 0), 45)
    scene |= {
        "sky": {"type": "constant", "radiance": rgb((0.35, 0.45, 0.7))},
        "sun": {
            "type": "directional",
            "direction": [-0.5, -0.8, -0.35],
            "irradiance": rgb((4, 3.7, 3.2)),
        },
        "floor": rectangle((0, 0, 0), (4, 4), "up", WOOD),
        "wall": box((0, 0.6, -2.5), (3, 0.6, 0.1), WHITE),
        "side": box((-2.6, 0.6, -0.6), (0.1, 0.6, 2), WHITE),
        "pot": box((-1.2, 0.35, -1.2), (0.35, 0.35, 0.35), RED),
        "ball": sphere((0.4, 0.45, 0.2), 0.45, {"type": "dielectric"}),
        "tabletop": box((1.4, 0.7, -0.7), (0.5, 0.03, 0.5), GREEN),
        "foot": box((1.4, 0.34, -0.7), (0.06, 0.34, 0.06), GREY),
    }
    return scene


def object_on_a_table() -> Dict:
    """A glass and a gold ball on a table in the middle of a large room."""
    scene = room((12, 5, 12)) | camera((0.75, 1.35, 0.95), (0, 0.85, 0), 38)
    scene |= {
        "table": box((0, 0.74, 0), (0.8, 0.03, 0.5), WOOD),
        "leg": box((0, 0.355, 0), (0.06, 0.355, 0.06), GREY),
        "glass": sphere((-0.1, 0.87, 0.05), 0.1, {"type": "dielectric"}),
        "gold": sphere((0.17, 0.83, -0.1), 0.06, {"type": "conductor", "material": "Au"}),
        "lamp": lamp((-0.7, 2.4, 0.3), (0.12, 0.12), 150),
        "ceiling_light": lamp((3, 4.98, -3), (0.6, 0.6), 12),
    }
    return scene


def corridor() -> Dict:
    """A corridor of 18 metres with three lamps."""
    scene = room((2.2, 2.5, 18)) | camera((0.5, 1.6, 8.4), (0, 1.2, 0), 65)
    for k, z in enumerate((-6, 0, 6)):
        scene[f"lamp_{k}"] = lamp((0, 2.48, z), (0.3, 0.15), 25)
    scene["locker"] = box((-0.9, 0.9, 2.5), (0.2, 0.9, 0.5), BLUE)
    scene["bench"] = box((0.85, 0.22, -2), (0.2, 0.22, 1), WOOD)
    scene["vase"] = sphere((0.85, 0.64, -1.6), 0.2, {"type": "dielectric"})
    return scene


def mirror_room() -> Dict:
    """A room with a mirror on one wall."""
    scene = room((4, 2.6, 4)) | camera((1.5, 1.5, 1.6), (-0.9, 0.9, -1.0), 60)
    mirror = rectangle((-1.98, 1.3, 0), (1.7, 1.1), "right", WHITE)
    scene["mirror"] = mirror | {"bsdf": {"type": "conductor", "material": "Ag"}}
    scene |= {
        "lamp": lamp((0.4, 2.58, -0.4), (0.35, 0.35), 26),
        "box": box((-0.6, 0.4, -0.9), (0.4, 0.4, 0.4), GREEN),
        "ball": sphere((0.5, 0.35, -1.0), 0.35, {"type": "roughplastic"}),
    }
    return scene


def pool() -> Dict:
    """A basin with water, lit by a small strong lamp, with a wall behind it."""
    scene = camera((2.9, 2.1, 3.3), (0, -0.2, -0.3), 45)
    scene |= {
        "sky": {"type": "constant", "radiance": rgb((0.1, 0.13, 0.2))},
        "lamp": lamp((1.5, 6, 1), (0.3, 0.3), 160),
        "water": rectangle((0, -0.15, 0), (1.5, 2), "up", WHITE)
        | {"bsdf": {"type": "dielectric", "int_ior": 1.33}},
        "bottom": rectangle((0, -1.2, 0), (1.5, 2), "up", (0.35, 0.6, 0.7)),
        "east": rectangle((1.5, -0.6, 0), (2, 0.6), "left", (0.35, 0.6, 0.7)),
        "west": rectangle((-1.5, -0.6, 0), (2, 0.6), "right", (0.35, 0.6, 0.7)),
        "north": rectangle((0, -0.6, -2), (1.5, 0.6), "front", (0.35, 0.6, 0.7)),
        "south": rectangle((0, -0.6, 2), (1.5, 0.6), "back", (0.35, 0.6, 0.7)),
        "deck_east": box((2.25, -0.05, 0), (0.75, 0.05, 3), WHITE),
        "deck_west": box((-2.25, -0.05, 0), (0.75, 0.05, 3), WHITE),
        "deck_north": box((0, -0.05, -2.5), (1.5, 0.05, 0.5), WHITE),
        "deck_south": box((0, -0.05, 2.5), (1.5, 0.05, 0.5), WHITE),
        "wall": box((0, 1, -3.1), (3, 1.1, 0.1), WHITE),
        "ball": sphere((0.3, -0.05, -0.4), 0.3, {"type": "diffuse", "reflectance": rgb(RED)}),
    }
    return scene


def spot_in_the_dark() -> Dict:
    """A stage with a spot light and nothing else."""
    scene = camera((2.6, 1.6, 3.6), (0, 0.6, 0), 45)
    scene |= {
        "floor": rectangle((0, 0, 0), (4, 4), "up", WOOD),
        "backdrop": rectangle((0, 2, -2.5), (4, 2), "front", GREY),
        "spot": {
            "type": "spot",
            "to_world": mi.ScalarTransform4f().look_at([1.5, 3.5, 2], [0, 0.3, -0.3], [0, 1, 0]),
            "intensity": rgb((60, 57, 50)),
            "cutoff_angle": 24,
            "beam_width": 18,
        },
        "cube": box((-0.5, 0.4, -0.4), (0.4, 0.4, 0.4), RED),
        "glass": sphere((0.5, 0.45, 0.1), 0.45, {"type": "dielectric"}),
    }
    return scene


def two_rooms() -> Dict:
    """A room whose light comes through a door from the room beside it."""
    scene = room((8, 2.6, 4)) | camera((3.4, 1.6, 1.5), (0.6, 0.9, -0.6), 60)
    scene |= {
        "partition_back": box((0, 1.3, -1.25), (0.06, 1.3, 0.75), WHITE),
        "partition_front": box((0, 1.3, 1.25), (0.06, 1.3, 0.75), WHITE),
        "lintel": box((0, 2.35, 0), (0.06, 0.25, 0.5), WHITE),
        "lamp": lamp((-2, 2.58, 0), (0.6, 0.6), 30),
        "table": box((1.6, 0.36, -0.7), (0.5, 0.36, 0.4), WOOD),
        "glass": sphere((1.6, 0.9, -0.7), 0.18, {"type": "dielectric"}),
    }
    return scene


def close_to_a_wall() -> Dict:
    """A room whose camera nearly touches a wall."""
    scene = room((5, 2.6, 4)) | camera((2.42, 1.5, 1.2), (-1.5, 0.8, -0.8), 65)
    scene |= {
        "lamp": lamp((-0.5, 2.58, 0), (0.45, 0.45), 22),
        "pillar": box((0.6, 1.3, -0.6), (0.15, 1.3, 0.15), GREY),
        "crate": box((-1.2, 0.4, -0.9), (0.4, 0.4, 0.4), WOOD),
        "glass": sphere((-1.2, 1.0, -0.9), 0.2, {"type": "dielectric"}),
    }
    return scene


def tumbler() -> Dict:
    """A tumbler of cut glass and a gold ball on a table under a spot light, in a large room."""
    scene = room((8, 3.5, 8)) | camera((0.5, 1.05, 0.62), (0, 0.81, 0), 34)
    target = [0, 0.77, 0]
    scene |= {
        "table": box((0, 0.74, 0), (0.7, 0.03, 0.5), WOOD),
        "leg": box((0, 0.355, 0), (0.06, 0.355, 0.06), GREY),
        "tumbler": _cut_glass((0, 0.7705, 0)),
        "gold": sphere((-0.16, 0.8, 0.1), 0.03, {"type": "roughconductor", "material": "Au"}),
        "spot": {
            "type": "spot",
            "to_world": mi.ScalarTransform4f().look_at([-1.1, 2.3, -0.6], target, [0, 1, 0]),
            "intensity": rgb((24, 23, 21)),
            "cutoff_angle": 26,
            "beam_width": 20,
        },
        "ceiling_light": lamp((1, 3.48, 1), (0.5, 0.5), 9),
    }
    return scene


SCENES: dict[str, Callable[[], Dict]] = {
    scene.__name__: scene
    for scene in (
        closed_room,
        open_box,
        terrace,
        object_on_a_table,
        corridor,
        mirror_room,
        pool,
        spot_in_the_dark,
        two_rooms,
        close_to_a_wall,
        tumbler,
    )
}
"""Name -> function that makes the dictionary for ``mitsuba.load_dict``."""


def _cut_glass(place: tuple[float, ...]) -> mi.Mesh:
    """A tumbler, 9.5 cm high, whose outer side is cut into diamonds of two depths."""
    sides, cuts = 18, np.linspace(0.012, 0.062, 6)
    outside = [(0.034 if k % 2 else 0.038, y) for k, y in enumerate(cuts)]
    inside = [(0.036, 0.094), (0.034, 0.06), (0.031, 0.016), (0.0, 0.013)]
    profile = [(0.0, 0.0), (0.034, 0.0), *outside, (0.039, 0.07), (0.039, 0.094), *inside]
    glass = lathe(np.array(profile), sides)
    turned = (np.hypot(*glass.points[:, [0, 2]].T) > 0.033) & np.isclose(
        glass.points[:, 1:2], cuts[1::2]
    ).any(axis=1)
    x, y, z = glass.points.T
    angle = np.where(turned, np.pi / sides, 0)  # half of a side, so that the sides are diamonds
    cos, sin = np.cos(angle), np.sin(angle)
    points = np.stack([cos * x + sin * z, y, cos * z - sin * x], axis=1)
    return triangles(replace(glass, points=points + place), {"type": "dielectric"})

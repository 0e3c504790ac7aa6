"""Small scenes, each with a light that a path tracer finds, to compare brightness in.

y is up; lengths are metres.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

import mitsuba as mi
import numpy as np

from benchmarks.check_scenes import closed_room
from gpf.scene.load import load_scene_file
from scenes.modelling.shapes import GREY, WHITE, Dict, box, camera, rectangle, rgb, room

SUN = (-0.5, 0.62, 0.6)
"""Direction towards the sun."""

GLASS_AT = (0.0, 0.3, 0.0)
"""Centre of the block of glass on a plane."""


def plane_under_sunsky() -> Dict:
    """A plane and a block of glass under Mitsuba's sky with its sun."""
    sky = {
        "type": "sunsky",
        "sun_direction": list(SUN),
        "turbidity": 3.0,
        "to_world": mi.ScalarTransform4f().rotate([1, 0, 0], -90),
    }
    return _plane() | {"sky": sky}


def plane_under_envmap() -> Dict:
    """The same under an environment map with a sun of a few pixels."""
    return _plane() | {"sky": {"type": "envmap", "bitmap": _sky_map()}}


def plane_with_compensation() -> mi.Scene:
    """The same under this map with ``mis_compensation``: Mitsuba does not sample its dim parts. It
    is loaded from a file, as only :func:`gpf.scene.load.load_scene_file` can mend that."""
    with tempfile.TemporaryDirectory() as folder:
        sky, file = Path(folder) / "sky.exr", Path(folder) / "scene.xml"
        _sky_map().write(str(sky))
        light = {"type": "envmap", "filename": str(sky), "mis_compensation": True}
        parsed = mi.parser.parse_dict(
            mi.parser.ParserConfig(mi.variant()), _plane() | {"sky": light}
        )
        file.write_text(mi.parser.write_string(parsed))
        return load_scene_file(file, width=96, height=72)


def sixteen_lamps() -> Dict:
    """A room with 16 point lamps below the ceiling."""
    return _lamps(4, 4)


def two_hundred_lamps() -> Dict:
    """A room with 200 point lamps below the ceiling."""
    return _lamps(10, 20)


def one_lamp() -> Dict:
    """A room with one lamp and a table."""
    left_out = ("glass", "gold", "shelf")
    return {name: part for name, part in closed_room().items() if name not in left_out}


def window_room() -> Dict:
    """The same room, lit only through a window, by the map with a sun."""
    scene = one_lamp()
    del scene["left"], scene["lamp"]
    return scene | {
        "sky": {"type": "envmap", "bitmap": _sky_map()},
        "below": box((-2.05, 0.45, 0), (0.05, 0.45, 2.5), WHITE),
        "above": box((-2.05, 2.4, 0), (0.05, 0.2, 2.5), WHITE),
        "beside": box((-2.05, 1.55, -1.6), (0.05, 0.65, 0.9), WHITE),
        "other side": box((-2.05, 1.55, 1.75), (0.05, 0.65, 0.75), WHITE),
    }


SCENES: dict[str, Callable[[], Dict | mi.Scene]] = {
    scene.__name__: scene
    for scene in (
        plane_under_sunsky,
        plane_under_envmap,
        sixteen_lamps,
        two_hundred_lamps,
        window_room,
        one_lamp,
        plane_with_compensation,
    )
}
"""Name -> function that makes the scene, or the dictionary for ``mitsuba.load_dict``."""


def _plane() -> Dict:
    scene = camera((3.6, 2.7, 4.2), (0, 0, 0), 40)
    scene |= {
        "floor": rectangle((0, 0, 0), (20, 20), "up", GREY),
        "glass": box(GLASS_AT, (0.3, 0.3, 0.3), WHITE) | {"bsdf": {"type": "dielectric"}},
    }
    return scene


def _sky_map() -> mi.Bitmap:
    """A blue sky with a sun of 2 × 2 pixels, which gives most of the light."""
    height, width = 128, 256
    row = (np.arange(height) + 0.5) / height * np.pi
    column = (np.arange(width) + 0.5) / width * 2 * np.pi
    up = np.cos(row)[:, None]
    pixels = np.where(up > 0, 0.3 + 0.4 * (1 - up), 0.1)[..., None] * np.array([0.6, 0.8, 1.2])
    pixels = np.broadcast_to(pixels, (height, width, 3)).astype(np.float32).copy()
    direction = np.array(SUN) / np.linalg.norm(SUN)
    # Mitsuba: (sin u sin v, cos v, -cos u sin v).
    y, x = np.arccos(direction[1]), np.arctan2(direction[0], -direction[2]) % (2 * np.pi)
    i, j = np.abs(row - y).argmin(), np.abs(column - x).argmin()
    pixels[i : i + 2, j : j + 2] = np.array([4200.0, 3900.0, 3400.0])
    return mi.Bitmap(pixels)


def _lamps(rows: int, columns: int) -> Dict:
    """A room with a grid of point lamps of different brightness."""
    scene = room((6, 2.6, 6)) | camera((2.7, 1.6, 2.7), (-0.6, 0.6, -0.9), 65)
    brightness = np.random.default_rng(1).uniform(0.2, 1.8, (rows, columns))
    for i in range(rows):
        for j in range(columns):
            place = [-2.5 + 5 * i / (rows - 1), 2.2, -2.5 + 5 * j / (columns - 1)]
            power = 40 / (rows * columns) * brightness[i, j]
            scene[f"lamp_{i}_{j}"] = {
                "type": "point",
                "position": place,
                "intensity": rgb((power, 0.95 * power, 0.85 * power)),
            }
    scene["table"] = closed_room()["table"]
    return scene

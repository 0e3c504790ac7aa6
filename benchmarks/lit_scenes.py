"""Small scenes, each with a light that a path tracer finds, for :mod:`benchmarks.energy`.

y is up; lengths are metres.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

import mitsuba as mi
import numpy as np

from gpf.modelling.shapes import (
    GREY,
    WHITE,
    WOOD,
    Dict,
    box,
    camera,
    lamp,
    rectangle,
    rgb,
    room,
)
from gpf.scene.load import load_scene_file

SUN = (-0.5, 0.62, 0.6)
"""Direction towards the sun."""


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
    return _plane() | {"sky": _sky_map()}


def sixteen_lamps() -> Dict:
    """A room with 16 point lamps below the ceiling."""
    return _lamps(4, 4)


def two_hundred_lamps() -> Dict:
    """A room with 200 point lamps below the ceiling."""
    return _lamps(10, 20)


def window_room() -> Dict:
    """A room lit only through a window, by the map with a sun."""
    scene = camera((1.7, 1.6, 2.2), (-0.8, 0.8, -1.2), 60) | {"sky": _sky_map()}
    walls = room((4, 2.6, 5))
    del walls["left"]
    scene |= walls
    scene |= {
        "below": box((-2.05, 0.45, 0), (0.05, 0.45, 2.5), WHITE),
        "above": box((-2.05, 2.4, 0), (0.05, 0.2, 2.5), WHITE),
        "beside": box((-2.05, 1.55, -1.6), (0.05, 0.65, 0.9), WHITE),
        "other side": box((-2.05, 1.55, 1.75), (0.05, 0.65, 0.75), WHITE),
        "table": box((-0.6, 0.36, -0.8), (0.7, 0.36, 0.45), WOOD),
    }
    return scene


def one_lamp() -> Dict:
    """A room with one lamp and a table."""
    scene = room((4, 2.6, 5)) | camera((1.7, 1.6, 2.2), (-0.8, 0.8, -1.2), 60)
    scene |= {
        "lamp": lamp((0, 2.58, 0), (0.5, 0.5), 18),
        "table": box((-0.6, 0.36, -0.8), (0.7, 0.36, 0.45), WOOD),
    }
    return scene


SCENES: dict[str, Callable[[], Dict]] = {
    scene.__name__: scene
    for scene in (
        plane_under_sunsky,
        plane_under_envmap,
        sixteen_lamps,
        two_hundred_lamps,
        window_room,
        one_lamp,
    )
}
"""Name -> function that makes the dictionary for ``mitsuba.load_dict``."""

COMPENSATED = "plane_with_compensation"
"""The plane under the same map with ``mis_compensation``, as a file: Mitsuba does not sample dim
parts of the map."""

_FILE = """
<scene version="3.0.0">
    <sensor type="perspective">
        <float name="fov" value="40"/>
        <transform name="to_world">
            <lookat origin="3.6, 2.7, 4.2" target="0, 0, 0" up="0, 1, 0"/>
        </transform>
        <film type="hdrfilm">
            <integer name="width" value="96"/><integer name="height" value="72"/>
            <rfilter type="box"/>
        </film>
    </sensor>
    <shape type="rectangle">
        <transform name="to_world"><rotate x="1" angle="-90"/><scale value="20"/></transform>
        <bsdf type="twosided"><bsdf type="diffuse">
            <rgb name="reflectance" value="0.45"/>
        </bsdf></bsdf>
    </shape>
    <shape type="cube">
        <transform name="to_world"><scale value="0.3"/><translate y="0.3"/></transform>
        <bsdf type="dielectric"/>
    </shape>
    <emitter type="envmap">
        <string name="filename" value="sky.exr"/>
        <boolean name="mis_compensation" value="true"/>
    </emitter>
</scene>"""

NAMES = (*SCENES, COMPENSATED)

GLASS_AT = {name: (0.0, 0.3, 0.0) for name in NAMES if name.startswith("plane")}
"""Scenes with a block of glass, and its centre."""


def load(name: str) -> mi.Scene:
    """One of :data:`NAMES`."""
    if name != COMPENSATED:
        return mi.load_dict(SCENES[name](), optimize=False)
    with tempfile.TemporaryDirectory() as folder:
        _sky_map()["bitmap"].write(str(Path(folder) / "sky.exr"))
        file = Path(folder) / "scene.xml"
        file.write_text(_FILE)
        return load_scene_file(file)


def _plane() -> Dict:
    scene = camera((3.6, 2.7, 4.2), (0, 0, 0), 40)
    scene |= {
        "floor": rectangle((0, 0, 0), (20, 20), "up", GREY),
        "glass": box((0, 0.3, 0), (0.3, 0.3, 0.3), WHITE) | {"bsdf": {"type": "dielectric"}},
    }
    return scene


def _sky_map() -> Dict:
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
    return {"type": "envmap", "bitmap": mi.Bitmap(pixels)}


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
    scene["table"] = box((-0.6, 0.36, -0.8), (0.7, 0.36, 0.45), WOOD)
    return scene

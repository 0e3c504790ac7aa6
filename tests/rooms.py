"""Three small rooms with the difficulties of real ones, for :func:`mitsuba.load_dict`.

y is up; lengths are metres. They are made in code, so that tests need no files.
"""

from __future__ import annotations

from collections.abc import Callable

import mitsuba as mi
import numpy as np

from gpf.modelling.meshes import grid, lathe
from scenes.modelling.shapes import (
    BLUE,
    GREEN,
    RED,
    WHITE,
    WOOD,
    Dict,
    Vector,
    box,
    camera,
    lamp,
    rectangle,
    rgb,
    room,
    sphere,
    triangles,
)

STEEL: Dict = {"type": "roughconductor", "material": "Cr", "alpha_u": 0.05, "alpha_v": 0.25}
"""Brushed steel."""

GLASS: Dict = {"type": "dielectric"}


def load(name: str) -> mi.Scene:
    """One of :data:`ROOMS` as a Mitsuba scene."""
    return mi.load_dict(ROOMS[name](), optimize=False)


def sunny_room() -> Dict:
    """A room lit by the sun and the sky through a window with bars, deep reveals and curtains of
    cloth with holes."""
    scene = camera((1.7, 1.5, 1.9), (-1.1, 0.85, -0.7), 66) | room((4, 2.6, 5))
    del scene["left"]
    scene |= {"sky": _sky()} | _window_wall(-2.15, 0.15)
    scene |= {
        "bar": box((-2.15, 1.55, 0.15), (0.02, 0.75, 0.02)),
        "cross bar": box((-2.15, 1.7, 0.15), (0.02, 0.02, 1)),
        "curtain": _curtain(-1.93, -0.75, -0.25),
        "other curtain": _curtain(-1.93, 0.55, 1.05),
        "rug": box((0, 0.006, 0), (0.9, 0.006, 1.3), RED),
        "picture": box((-0.4, 1.6, -2.48), (0.5, 0.35, 0.02), BLUE),
        "frame": box((-0.4, 1.97, -2.47), (0.54, 0.02, 0.03), WOOD),
    }
    scene |= _table((-0.4, 0, -0.6), (0.6, 0.4), "table") | _table((-0.5, 0, 0.6), (0.22, 0.22), "")
    return scene


def evening_room() -> Dict:
    """A room in the evening: a lamp behind a shade, a bulb in glass, and a mirror."""
    scene = camera((1.5, 1.5, 1.7), (-0.9, 0.9, -1.0), 64) | room((4, 2.6, 4))
    shade = lathe(np.array([[0.2, 1.35], [0.13, 1.65]]), 32).transformed(_shift((-1.5, 0, -1.5)))
    bulb = {"type": "area", "radiance": rgb((60, 52, 40))}
    cloth = {"type": "diffuse", "reflectance": rgb((0.8, 0.7, 0.5))}
    scene |= {
        "shade": triangles(shade, {"type": "twosided", "bsdf": cloth}),
        "shaded bulb": sphere((-1.5, 1.5, -1.5), 0.05, cloth) | {"emitter": bulb},
        "stand": box((-1.5, 0.65, -1.5), (0.015, 0.65, 0.015), WOOD),
        "foot": box((-1.5, 0.01, -1.5), (0.15, 0.01, 0.15), WOOD),
        "globe": sphere((1.1, 1.9, -1.2), 0.12, GLASS),
        "filament": sphere((1.1, 1.9, -1.2), 0.08, cloth)
        | {"emitter": {"type": "area", "radiance": rgb((15, 13, 10))}},
        "mirror": rectangle((-1.98, 1.3, 0.2), (0.8, 0.6), "right")
        | {"bsdf": {"type": "conductor", "material": "Ag"}},
        "chest": box((0.4, 0.35, -1.7), (0.5, 0.35, 0.25), GREEN),
        "vase": sphere(
            (0.3, 0.82, -1.7), 0.12, {"type": "plastic", "diffuse_reflectance": rgb(BLUE)}
        ),
    }
    return scene | _table((-0.2, 0, -0.2), (0.5, 0.35), "table")


def kitchen() -> Dict:
    """A kitchen of steel and lacquer, open to a sky, with small things below a cupboard."""
    scene = camera((1.1, 1.55, 1.5), (-0.7, 1.0, -1.1), 58) | room((4, 2.6, 4))
    del scene["front"]
    tiles = {"type": "roughplastic", "diffuse_reflectance": rgb((0.7, 0.7, 0.65)), "alpha": 0.1}
    scene["floor"]["bsdf"] = tiles
    scene |= {
        "sky": {"type": "constant", "radiance": rgb((1.6, 1.8, 2.2))},
        "hood": lamp((-0.4, 1.748, -1.72), (0.25, 0.06), 12),
        "counter": box((-0.5, 0.44, -1.7), (1.5, 0.44, 0.3)) | {"bsdf": _lacquer(RED)},
        "worktop": box((-0.5, 0.9, -1.68), (1.5, 0.02, 0.32)) | {"bsdf": STEEL},
        "cupboard": box((-0.5, 2.05, -1.8), (1.5, 0.3, 0.2)) | {"bsdf": _lacquer(RED)},
        "fridge": box((1.45, 0.95, -1.65), (0.35, 0.95, 0.35)) | {"bsdf": STEEL},
        "knife block": box((-1.3, 1.02, -1.75), (0.06, 0.1, 0.08), (0.05, 0.04, 0.03)),
        "paper roll": triangles(
            lathe(np.array([[0, 0.92], [0.06, 0.92], [0.06, 1.16], [0, 1.16]]), 24).transformed(
                _shift((-0.9, 0, -1.75))
            ),
            {"type": "diffuse", "reflectance": rgb(WHITE)},
        ),
        "pot": sphere((0.2, 1.03, -1.65), 0.11, STEEL),
        "tumbler": _tumbler((0.55, 0.921, -1.6)),
        "handle": box((-0.5, 0.78, -1.385), (0.3, 0.008, 0.008)) | {"bsdf": STEEL},
    }
    for k in range(4):
        scene[f"jar {k}"] = sphere((-0.7 + 0.13 * k, 0.965, -1.85), 0.045, {"type": "plastic"})
    return scene | _table((-0.3, 0, 0.3), (0.55, 0.35), "table")


ROOMS: dict[str, Callable[[], Dict]] = {
    make.__name__: make for make in (sunny_room, evening_room, kitchen)
}
"""Name -> function that makes the dictionary."""


def _table(place: Vector, half: tuple[float, float], name: str) -> Dict:
    """A table with four thin legs, or a stool if ``name`` is empty."""
    x, _, z = place
    height = 0.72 if name else 0.44
    legs = {
        f"{name} leg {i} {j}": box(
            (x + i * (half[0] - 0.03), height / 2, z + j * (half[1] - 0.03)),
            (0.015, height / 2, 0.015),
            WOOD,
        )
        for i in (-1, 1)
        for j in (-1, 1)
    }
    return legs | {f"{name} top": box((x, height + 0.015, z), (half[0], 0.015, half[1]), WOOD)}


def _window_wall(x: float, half: float) -> Dict:
    """The left wall, centred on x with half-thickness ``half``, with a window in its middle."""
    return {
        "below": box((x, 0.4, 0), (half, 0.4, 2.5)),
        "above": box((x, 2.45, 0), (half, 0.15, 2.5)),
        "beside": box((x, 1.55, -1.675), (half, 0.75, 0.825)),
        "other side": box((x, 1.55, 1.825), (half, 0.75, 0.675)),
    }


def _curtain(x: float, first: float, last: float) -> mi.Mesh:
    """Cloth in folds from z = ``first`` to ``last``; a third of it is holes."""
    z, y = np.linspace(first, last, 41), np.linspace(0.05, 2.35, 8)
    fold = x + 0.03 * np.sin(50 * z)
    rows = np.stack([np.broadcast_to(c, (8, 41)) for c in (fold, y[:, None], z)], axis=-1)
    uv = np.stack(np.meshgrid(np.linspace(0, 1, 41), np.linspace(0, 1, 8)), axis=-1)
    holes = np.kron([[1, 1, 0], [1, 1, 1], [0, 1, 0]], np.ones((2, 2)))[..., None]
    cloth = {
        "type": "mask",
        "opacity": {
            "type": "bitmap",
            "bitmap": mi.Bitmap(holes.astype(np.float32)),
            "raw": True,
            "filter_type": "nearest",
            "to_uv": mi.ScalarTransform4f().scale([20, 60, 1]),
        },
        "bsdf": {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": rgb(WHITE)}},
    }
    return triangles(grid(rows, uv=uv), cloth)


def _tumbler(place: Vector) -> mi.Mesh:
    profile = [[0, 0], [0.03, 0], [0.036, 0.1], [0.033, 0.1], [0.028, 0.01], [0, 0.01]]
    return triangles(lathe(np.array(profile), 24).transformed(_shift(place)), GLASS)


def _lacquer(colour: Vector) -> Dict:
    return {"type": "plastic", "diffuse_reflectance": rgb(colour)}


def _shift(offset: Vector) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, 3] = offset
    return matrix


def _sky() -> Dict:
    """A sky with a sun that shines into the window on the left."""
    turned = mi.ScalarTransform4f().rotate([1, 0, 0], -90)
    return {
        "type": "sunsky",
        "sun_direction": [-0.75, 0.55, 0.3],
        "turbidity": 3.0,
        "to_world": turned,
    }

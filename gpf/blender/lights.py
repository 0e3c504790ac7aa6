"""Blender's lamps and world as Mitsuba's emitters.

A lamp of Φ watts gives the following; its colour c is a factor of each channel.

=====  ===================================  ===========================
point  I = Φ / 4π                           or a sphere, L = Φ / 4π²r²
spot   I = Φ / 4π on its axis
area   L = Φ / πA
sun    E = its strength
=====  ===================================  ===========================
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

Dict = dict[str, Any]
Lamp = Mapping[str, Any]

SUN_ROWS = 512
"""Least rows of a map of all directions that has a sun."""

SUN_PIXELS = 8
"""Pixels across a sun."""

MOST_ROWS = 2048


def emitters(lamps: Sequence[Lamp], notes: list[str]) -> dict[str, Dict]:
    """Emitters and shapes for all lamps but suns with an angle (:func:`sky`), by name."""
    found: dict[str, Dict] = {}
    for lamp in lamps:
        if lamp["type"] == "SUN" and lamp["angle"] > 0:
            continue
        name = lamp["name"]
        while name in found:  # the lamp is in a collection of which there are copies
            name += " copy"
        found[name] = _emitter(lamp, notes)
    return found


def _emitter(lamp: Lamp, notes: list[str]) -> Dict:
    matrix, name = np.array(lamp["matrix"]), lamp["name"]
    power = np.array(lamp["color"]) * lamp["energy"]
    place, forward = matrix[:3, 3], -matrix[:3, 2]
    if lamp["type"] == "SUN":
        return {"type": "directional", "direction": forward.tolist(), "irradiance": _rgb(power)}
    if lamp["type"] == "AREA":
        return _area(lamp, matrix, power, notes)
    if lamp["type"] == "SPOT":
        if lamp["radius"] > 0:
            notes.append(f"{name}: spot with a radius as a point")
        if lamp["spot_blend"] > 0:
            notes.append(f"{name}: soft edge of the spot with another curve")
        half = math.degrees(lamp["spot_size"]) / 2
        look = mi.ScalarTransform4f().look_at(place, place + forward, matrix[:3, 1])
        return {
            "type": "spot",
            "to_world": look,
            "intensity": _rgb(power / (4 * math.pi)),
            "cutoff_angle": half,
            "beam_width": half * (1 - lamp["spot_blend"]) ** 0.5,
        }
    radius = lamp["radius"]  # whatever the lamp's scale
    if radius == 0:
        return {
            "type": "point",
            "position": place.tolist(),
            "intensity": _rgb(power / (4 * math.pi)),
        }
    radiance = power / (4 * math.pi**2 * radius**2)
    return {
        "type": "sphere",
        "center": place.tolist(),
        "radius": radius,
        "emitter": {"type": "area", "radiance": _rgb(radiance)},
        "bsdf": _BLACK,
    }


_BLACK: Dict = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.0, 0.0, 0.0]}}


def _area(lamp: Lamp, matrix: np.ndarray, power: np.ndarray, notes: list[str]) -> Dict:
    if lamp["spread"] < math.pi - 1e-3:
        notes.append(
            f"{lamp['name']}: shines in all directions of its side, not in a narrower cone"
        )
    half = np.diag([*(0.5 * np.array(lamp["size"])), 1.0, 1.0])
    turned = np.diag([1.0, -1.0, -1.0, 1.0])  # Blender's lamps shine along -z
    to_world = matrix @ turned @ half
    a, b = to_world[:3, 0], to_world[:3, 1]
    surface = np.linalg.norm(np.cross(a, b)) * (math.pi if lamp["round"] else 4)
    radiance = power / (math.pi * surface)
    return {
        "type": "disk" if lamp["round"] else "rectangle",
        "to_world": mi.ScalarTransform4f(to_world),
        "emitter": {"type": "area", "radiance": _rgb(radiance)},
        "bsdf": _BLACK,
    }


def suns_with_an_angle(lamps: Sequence[Lamp]) -> list[Lamp]:
    """The suns that are part of the sky."""
    return [lamp for lamp in lamps if lamp["type"] == "SUN" and lamp["angle"] > 0]


def sky(
    world: Mapping[str, Any] | None,
    lamps: Sequence[Lamp],
    work: Path,
    folder: Path,
    file: str = "textures/sky.exr",
) -> Dict:
    """One emitter for the world and all suns with an angle, or an empty dictionary.

    ``file``: for its map, in ``folder``; one that is there is used.
    """
    suns = suns_with_an_angle(lamps)
    if not suns:
        if world is None:
            return {}
        if "radiance" in world:
            return {"sky": {"type": "constant", "radiance": _rgb(world["radiance"])}}
    if not (folder / file).exists():
        pixels = _background(world, work)
        for sun in suns:
            pixels = _add_sun(pixels, sun)
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        mi.Bitmap(pixels).write(str(folder / file))
    # Mitsuba's maps have +y up; what is written here has +x in the middle.
    turn = mi.ScalarTransform4f().rotate([1, 0, 0], 90).rotate([0, 1, 0], 90)
    return {"sky": {"type": "envmap", "filename": file, "to_world": turn}}


def _background(world: Mapping[str, Any] | None, work: Path) -> np.ndarray:
    if world is not None and "file" in world:
        pixels = np.array(mi.Bitmap(str(work / world["file"])), dtype=np.float32)[..., :3]
        return np.maximum(np.nan_to_num(pixels, posinf=0.0), 0)
    colour = [0.0, 0.0, 0.0] if world is None else world["radiance"]
    return np.tile(np.array(colour, np.float32), (SUN_ROWS, 2 * SUN_ROWS, 1))


def _add_sun(pixels: np.ndarray, sun: Lamp) -> np.ndarray:
    """The map with a disc that gives the sun's irradiance."""
    wanted = SUN_PIXELS * math.pi / sun["angle"]
    rows = int(2 ** np.clip(np.ceil(np.log2(max(wanted, pixels.shape[0]))), 0, np.log2(MOST_ROWS)))
    times = max(rows // pixels.shape[0], 1)
    pixels = pixels.repeat(times, axis=0).repeat(times, axis=1)
    height, width = pixels.shape[:2]
    # Mitsuba interpolates between rows, the first and the last of which are at the poles.
    step = math.pi / (height - 1)
    polar = step * np.arange(height)
    weight = np.sin(polar) * 2 * (1 - math.cos(step)) / step
    weight[[0, -1]] = 1 - math.sin(step) / step
    around = math.pi - 2 * math.pi * (np.arange(width) + 0.5) / width  # the middle is +x
    matrix = np.array(sun["matrix"])
    to = matrix[:3, 2] / np.linalg.norm(matrix[:3, 2])
    cosine = np.sin(polar)[:, None] * (np.cos(around) * to[0] + np.sin(around) * to[1])
    cosine = cosine + np.cos(polar)[:, None] * to[2]
    inside = cosine > math.cos(max(sun["angle"] / 2, step))
    solid = (weight[:, None] * inside).sum() * 2 * math.pi / width
    irradiance = np.array(sun["color"]) * sun["energy"]
    pixels = pixels.copy()
    pixels[inside] += (irradiance / solid).astype(np.float32)
    return pixels


def _rgb(colour: Any) -> Dict:
    return {"type": "rgb", "value": [float(c) for c in colour]}

"""Lamps in plain words; values are those of :mod:`baselines.translation.values`.

===========  ===================================================================================
kind         other keys
===========  ===================================================================================
point        ``position``, ``intensity``
spot         ``matrix``, ``intensity``; full up to the angle ``beam``, from there in proportion to
             the angle down to 0 at ``cutoff``, radians
projector    ``matrix``, ``irradiance`` at a distance of 1 on the plane across the axis, which it
             covers to half of ``size``
directional  ``direction``, ``irradiance``
constant     ``radiance``
envmap       ``image`` whose middle is -z and whose top is +y, ``matrix``
===========  ===================================================================================

A matrix maps to the world; spots and projectors shine along +z, and the image of a projector
begins at +x and +y. Area lights are parts of shapes (:mod:`baselines.translation.description`).
"""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from baselines.translation.nodes import Node
from baselines.translation.values import Values

Lamp = dict[str, Any]

MOST_ROWS = 2048
"""Of a map of all directions."""


def read_lamp(node: Node, values: Values) -> Lamp:
    """The lamp of an emitter that is no part of a shape.

    Raises
    ------
    CannotServe: emitters of this type are not translated.
    """
    matrix = _matrix(node)
    if node.plugin == "point":
        place = node.values.get("position", matrix[:3, 3])
        intensity = values.radiance(node, "intensity")
        return {"kind": "point", "position": [float(x) for x in place], "intensity": intensity}
    if node.plugin == "spot":
        return _spot(node, values, matrix)
    if node.plugin == "projector":
        return _projector(node, values, matrix)
    if node.plugin == "directional":
        along = np.array(node.values.get("direction", matrix[:3, 2]), dtype=float).ravel()
        found = {"kind": "directional", "direction": (along / np.linalg.norm(along)).tolist()}
        return found | {"irradiance": values.radiance(node, "irradiance")}
    if node.plugin == "constant":
        return {"kind": "constant", "radiance": values.radiance(node, "radiance")}
    if node.plugin == "envmap":
        return _envmap(node, values, matrix)
    raise values.refuse(f"lamps of type {node.plugin} are not translated")


def _matrix(node: Node) -> np.ndarray:
    if "to_world" not in node.values:
        return np.eye(4)
    return np.array(node.values["to_world"].matrix, dtype=float).reshape(4, 4)


def _spot(node: Node, values: Values, matrix: np.ndarray) -> Lamp:
    if "texture" in node.parts:
        raise values.refuse("spots with a texture are not translated")
    cutoff = math.radians(node.values.get("cutoff_angle", 20.0))
    beam = math.radians(node.values.get("beam_width", math.degrees(cutoff) * 0.75))
    found = {"kind": "spot", "matrix": matrix.tolist(), "cutoff": cutoff, "beam": beam}
    return found | {"intensity": values.radiance(node, "intensity")}


def _projector(node: Node, values: Values, matrix: np.ndarray) -> Lamp:
    irradiance = values.radiance(node, "irradiance")
    aspect = 1.0
    if isinstance(irradiance, dict):
        height, width = np.load(values.folder / irradiance["image"]).shape[:2]
        aspect = width / height
    scale = float(node.values.get("scale", 1.0))
    # Mitsuba's unit: a diffuse surface of albedo 1 there has that radiance.
    irradiance = values.changed(irradiance, lambda e: e * scale * math.pi)
    half = math.tan(math.radians(_field_of_view(node, aspect)) / 2)
    found = {"kind": "projector", "matrix": matrix.tolist(), "irradiance": irradiance}
    return found | {"size": [2 * half, 2 * half / aspect]}


def _field_of_view(node: Node, aspect: float) -> float:
    """The angle across x, degrees."""
    fov, axis = float(node.values.get("fov", 90.0)), node.values.get("fov_axis", "x")
    if axis == "smaller":
        axis = "y" if aspect > 1 else "x"
    elif axis == "larger":
        axis = "x" if aspect > 1 else "y"
    half = math.tan(math.radians(fov) / 2)
    if axis == "y":
        half *= aspect
    elif axis == "diagonal":
        half *= aspect / math.hypot(aspect, 1)
    return math.degrees(2 * math.atan(half))


def _envmap(node: Node, values: Values, matrix: np.ndarray) -> Lamp:
    """Mitsuba's texels lie on the edges of the map, those of others do not: so it is sampled."""
    upright = {key: value for key, value in node.values.items() if key != "to_world"}
    sky = mi.load_dict({"type": "envmap", **upright})
    height, width = mi.traverse(sky)["data"].shape[:2]
    rows, columns = (min(2 * n, most) for n, most in ((height, MOST_ROWS), (width, 2 * MOST_ROWS)))
    index = dr.arange(mi.UInt32, rows * columns)
    elevation = dr.pi * ((index // columns) + 0.5) / rows
    azimuth = dr.two_pi * ((index % columns) + 0.5) / columns
    sine = dr.sin(elevation)
    si = dr.zeros(mi.SurfaceInteraction3f, rows * columns)
    si.wi = -mi.Vector3f(sine * dr.sin(azimuth), dr.cos(elevation), -sine * dr.cos(azimuth))
    pixels = np.array(sky.eval(si), dtype=np.float32).T.reshape(rows, columns, 3)
    return {"kind": "envmap", "image": values.save(pixels), "matrix": matrix.tolist()}

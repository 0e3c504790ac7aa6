"""Lamps, in Blender's units."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import bmesh
import bpy
import numpy as np
from around import answer_as_for_surfaces, save_exr, scene_around
from nodes import plain_closure, plain_inputs, read_closure
from sockets import Input, is_constant
from sources import socket_of, sources

WIDTH = 128
"""Width of the picture of the light around a lamp, pixels."""

SAMPLES = 16


def read_lamp(name: str, lamp: Any, matrix: np.ndarray, tint: np.ndarray) -> dict[str, Any] | None:
    """A lamp in plain values, or None if it is dark, as those scaled to nothing are.

    ``color`` times ``energy`` is in W for lamps with a place and in W/m² for the sun; the lamp
    looks along -z of its matrix. ``tint``: what its nodes multiply its light by, (3,).
    """
    colour = np.array(lamp.color) * tint
    if getattr(lamp, "use_temperature", False):
        colour = colour * np.array(lamp.temperature_color)
    scaled = {"POINT": 1, "SUN": np.linalg.norm(matrix[:3, 2])}
    if not colour.any() or not scaled.get(lamp.type, np.linalg.det(matrix)):
        return None
    found = {"name": name, "type": lamp.type, "color": colour.tolist(), "matrix": matrix.tolist()}
    if lamp.type == "SUN":
        found["angle"] = float(lamp.angle)
        area = math.pi * math.sin(lamp.angle / 2) ** 2 or 1
    elif lamp.type == "AREA":
        height = lamp.size_y if lamp.shape in ("RECTANGLE", "ELLIPSE") else lamp.size
        found |= {"size": [float(lamp.size), float(height)], "spread": float(lamp.spread)}
        found["round"] = lamp.shape in ("DISK", "ELLIPSE")
        area = lamp.size * height * (math.pi / 4 if found["round"] else 1)
        area *= np.linalg.norm(np.cross(matrix[:3, 0], matrix[:3, 1]))
    else:
        found["radius"] = float(lamp.shadow_soft_size)
        area = 4 * math.pi * lamp.shadow_soft_size**2 or 4
        if lamp.type == "SPOT":
            found |= {"spot_size": float(lamp.spot_size), "spot_blend": float(lamp.spot_blend)}
    # By default, Cycles divides the power by this area.
    share = 1 if getattr(lamp, "normalize", True) else area
    found["energy"] = float(lamp.energy * 2.0 ** getattr(lamp, "exposure", 0.0) * share)
    return found if found["energy"] != 0 else None


@dataclass
class Lamps:
    """Reads what the nodes of lamps make of their light.

    Attributes
    ----------
    folder: for images.
    notes: what is approximated.
    """

    folder: Path
    notes: list[str] = field(default_factory=list)
    _known: dict[str, np.ndarray] = field(default_factory=dict)

    def tints(self) -> dict[str, np.ndarray]:
        """By the name of a lamp's data, what its nodes multiply its light by, (3,)."""
        self.notes.clear()
        lamps = [lamp for lamp in bpy.data.lights if lamp.use_nodes and lamp.node_tree]
        return {lamp.name: self._tint(lamp) for lamp in lamps}

    def _tint(self, lamp: Any) -> np.ndarray:
        answer_as_for_surfaces(lamp.node_tree)
        output = lamp.node_tree.get_output_node("CYCLES")
        found = read_closure(Input(output.inputs["Surface"])) if output else {"closure": "none"}
        if found["closure"] == "none":
            return np.zeros(3)
        inputs = plain_inputs(found)
        if found["closure"] == "emission" and not inputs:
            return np.array(found["color"]) * found["strength"]
        if not all(is_constant(socket_of(value)) for value in inputs):
            self.notes.append(f"{lamp.name}: its nodes as their mean over all directions")
        origin = f"{lamp.name} {plain_closure(found)} {sources(found)}"
        if origin not in self._known:
            whole, plain = (_light_around(lamp, nodes, self.folder) for nodes in (True, False))
            self._known[origin] = whole / np.maximum(plain, 1e-30)
        return self._known[origin]


def _light_around(lamp: Any, nodes: bool, folder: Path) -> np.ndarray:
    """What a lamp, if it were white, sends to the inside of a ball, (3,); rendered by Cycles."""
    lamp = lamp.copy()
    lamp.color, lamp.energy, lamp.use_nodes = (1, 1, 1), 1, nodes
    mesh, ball = bpy.data.meshes.new("gpf ball"), bmesh.new()
    radius = 10 * max(lamp.size, lamp.size_y) if lamp.type == "AREA" else 1
    bmesh.ops.create_icosphere(ball, subdivisions=4, radius=radius)
    ball.to_mesh(mesh)
    with scene_around(WIDTH, SAMPLES) as scene:
        scene.cycles.max_bounces = 0
        for data in (mesh, lamp):
            thing = bpy.data.objects.new("gpf", data)
            scene.collection.objects.link(thing)
            thing.visible_shadow, thing.visible_camera = False, data is mesh
        save_exr(scene, folder / "lamp.exr")
    image = bpy.data.images.load(str(folder / "lamp.exr"))
    image.colorspace_settings.name = "Non-Color"
    pixels = np.array(image.pixels[:]).reshape(WIDTH // 2, WIDTH, -1)[..., :3]
    for owner, data in (("images", image), ("meshes", mesh), ("lights", lamp)):
        getattr(bpy.data, owner).remove(data)
    polar = np.pi * (np.arange(WIDTH // 2) + 0.5) / (WIDTH // 2)
    return np.asarray((np.sin(polar)[:, None, None] * pixels).sum(axis=(0, 1)))

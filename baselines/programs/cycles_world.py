"""Lamps of a description (:mod:`baselines.translation.lamps`) as Blender's lamps and world."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from cycles_materials import (  # type: ignore[import-not-found]  # in the folder of this script
    WRAPS,
    make_image,
)
from mathutils import Matrix


def add_lamp(lamp: dict[str, Any], folder: Path, images: dict[str, Any]) -> Any:
    """Add a lamp to the scene; its data, or the world."""
    if lamp["kind"] in ("constant", "envmap"):
        return _set_world(lamp, folder)
    return _KINDS[lamp["kind"]](lamp, folder)


def _add(kind: str, matrix: np.ndarray) -> Any:
    data = bpy.data.lights.new(kind, kind)
    if kind != "SUN":
        data.shadow_soft_size = 0
    thing = bpy.data.objects.new(kind, data)
    bpy.context.scene.collection.objects.link(thing)
    thing.matrix_world = Matrix(matrix.tolist())
    return data


def _shine(data: Any, power: Any) -> None:
    power = np.broadcast_to(power, 3)
    data.energy = power.max()
    data.color = power / max(power.max(), 1e-30)


def _point(lamp: dict[str, Any], folder: Path) -> Any:
    matrix = np.eye(4)
    matrix[:3, 3] = lamp["position"]
    data = _add("POINT", matrix)
    _shine(data, 4 * math.pi * np.array(lamp["intensity"]))
    return data


def _directional(lamp: dict[str, Any], folder: Path) -> Any:
    ahead = np.array(lamp["direction"])
    side = np.cross(ahead, np.eye(3)[np.abs(ahead).argmin()])
    side /= np.linalg.norm(side)
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([side, np.cross(-ahead, side), -ahead], axis=1)
    data = _add("SUN", matrix)
    data.angle = 0
    _shine(data, lamp["irradiance"])
    return data


class _Directions:
    """Nodes of a lamp whose intensity depends on the direction."""

    def __init__(self, data: Any, matrix: np.ndarray) -> None:
        data.use_nodes = True
        self.tree = data.node_tree
        self.emission = next(n for n in self.tree.nodes if n.type == "EMISSION")
        # The direction from the lamp, in the lamp's coordinates.
        incoming = self.tree.nodes.new("ShaderNodeNewGeometry").outputs["Incoming"]
        axes = matrix[:3, :3] / np.linalg.norm(matrix[:3, :3], axis=0)
        self.x, self.y, self.z = (self.dot(incoming, axis) for axis in axes.T)

    def dot(self, vector: Any, along: np.ndarray) -> Any:
        node = self.tree.nodes.new("ShaderNodeVectorMath")
        node.operation = "DOT_PRODUCT"
        self.tree.links.new(vector, node.inputs[0])
        node.inputs[1].default_value = along
        return node.outputs["Value"]

    def math(self, operation: str, *values: Any, clamp: bool = False) -> Any:
        node = self.tree.nodes.new("ShaderNodeMath")
        node.operation, node.use_clamp = operation, clamp
        for socket, value in zip(node.inputs, values, strict=False):
            if isinstance(value, (int, float)):
                socket.default_value = value
            else:
                self.tree.links.new(value, socket)
        return node.outputs[0]

    def set(self, name: str, value: Any) -> None:
        self.tree.links.new(value, self.emission.inputs[name])


def _spot(lamp: dict[str, Any], folder: Path) -> Any:
    """A point whose intensity falls with the angle: Blender's own spots have another curve."""
    matrix = np.array(lamp["matrix"])
    data = _point({"position": matrix[:3, 3], "intensity": lamp["intensity"]}, folder)
    way = _Directions(data, matrix)
    angle = way.math("ARCCOSINE", way.math("MINIMUM", way.z, 1.0))
    fall = max(lamp["cutoff"] - lamp["beam"], 1e-6)
    left = way.math("DIVIDE", way.math("SUBTRACT", lamp["cutoff"], angle), fall, clamp=True)
    way.set("Strength", left)
    return data


def _projector(lamp: dict[str, Any], folder: Path) -> Any:
    """A point with the intensity E / cos³ where its image is."""
    matrix, irradiance = np.array(lamp["matrix"]), lamp["irradiance"]
    textured = isinstance(irradiance, dict)
    intensity = 1.0 if textured else irradiance
    data = _point({"position": matrix[:3, 3], "intensity": intensity}, folder)
    way = _Directions(data, matrix)
    inside = way.math("GREATER_THAN", way.z, 0.0)
    places = []
    for value, size in zip((way.x, way.y), lamp["size"], strict=True):
        across = way.math("DIVIDE", value, way.math("MAXIMUM", way.z, 1e-6))
        places.append(way.math("SUBTRACT", 0.5, way.math("DIVIDE", across, size)))
        near = way.math("LESS_THAN", way.math("ABSOLUTE", across), size / 2)
        inside = way.math("MULTIPLY", inside, near)
    cubed = way.math("POWER", way.math("MAXIMUM", way.z, 1e-6), 3.0)
    way.set("Strength", way.math("DIVIDE", inside, cubed))
    if textured:
        node = way.tree.nodes.new("ShaderNodeTexImage")
        node.image = make_image("projector", np.load(folder / irradiance["image"]))
        node.extension = WRAPS[irradiance["wrap"]]
        node.interpolation = "Closest" if irradiance["nearest"] else "Linear"
        joined = way.tree.nodes.new("ShaderNodeCombineXYZ")
        for socket, place in zip(joined.inputs, places, strict=False):
            way.tree.links.new(place, socket)
        way.tree.links.new(joined.outputs[0], node.inputs["Vector"])
        way.set("Color", node.outputs["Color"])
    return data


def _set_world(lamp: dict[str, Any], folder: Path) -> Any:
    """The light from far away."""
    world = bpy.data.worlds.new(lamp["kind"])
    bpy.context.scene.world = world
    world.use_nodes = True
    tree = world.node_tree
    background = next(n for n in tree.nodes if n.type == "BACKGROUND")
    background.inputs["Strength"].default_value = 1.0
    if lamp["kind"] == "constant":
        background.inputs["Color"].default_value = (*np.broadcast_to(lamp["radiance"], 3), 1)
        return world
    node = tree.nodes.new("ShaderNodeTexEnvironment")
    node.image = make_image("sky", np.load(folder / lamp["image"])[::-1])
    axes = np.array(lamp["matrix"])[:3, :3]
    axes = axes / np.linalg.norm(axes, axis=0)
    ahead = tree.nodes.new("ShaderNodeTexCoord").outputs["Generated"]
    joined = tree.nodes.new("ShaderNodeCombineXYZ")
    # Blender's maps have -x in the middle and +z at the top.
    for socket, axis in zip(joined.inputs, (axes[:, 2], axes[:, 0], axes[:, 1]), strict=True):
        dot = tree.nodes.new("ShaderNodeVectorMath")
        dot.operation = "DOT_PRODUCT"
        tree.links.new(ahead, dot.inputs[0])
        dot.inputs[1].default_value = axis
        tree.links.new(dot.outputs["Value"], socket)
    tree.links.new(joined.outputs[0], node.inputs["Vector"])
    tree.links.new(node.outputs["Color"], background.inputs["Color"])
    return world


_KINDS: dict[str, Callable[[dict[str, Any], Path], Any]] = {
    "point": _point,
    "spot": _spot,
    "projector": _projector,
    "directional": _directional,
}

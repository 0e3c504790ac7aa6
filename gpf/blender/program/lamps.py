"""Lamps and the world, in Blender's units."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from nodes import plain_closure, read_closure, values
from sockets import Input
from sources import sources

WIDTH = 2048
"""Width of the environment map, pixels."""


def read_lamp(name: str, lamp: Any, matrix: np.ndarray) -> dict[str, Any] | None:
    """A lamp in plain values, or None if it is dark.

    ``color`` times ``energy`` is in W for lamps with a place and in W/m² for the sun; the lamp
    looks along -z of its matrix.
    """
    colour = np.array(lamp.color) * _tint(lamp)
    if getattr(lamp, "use_temperature", False):
        colour = colour * np.array(lamp.temperature_color)
    energy = float(lamp.energy) * 2.0 ** float(getattr(lamp, "exposure", 0.0))
    if energy == 0 or not colour.any():
        return None
    found = {
        "name": name,
        "type": lamp.type,
        "color": colour.tolist(),
        "energy": energy,
        "matrix": matrix.tolist(),
        "normalized": bool(getattr(lamp, "normalize", True)),
    }
    if lamp.type == "SUN":
        found["angle"] = float(lamp.angle)
    elif lamp.type == "AREA":
        height = lamp.size_y if lamp.shape in ("RECTANGLE", "ELLIPSE") else lamp.size
        found |= {"size": [float(lamp.size), float(height)], "spread": float(lamp.spread)}
        found["round"] = lamp.shape in ("DISK", "ELLIPSE")
    else:
        found["radius"] = float(lamp.shadow_soft_size)
        if lamp.type == "SPOT":
            found |= {"spot_size": float(lamp.spot_size), "spot_blend": float(lamp.spot_blend)}
    return found


def _tint(lamp: Any) -> np.ndarray:
    """What a lamp's own nodes multiply its light by, where that is a constant."""
    if lamp.node_tree is None or not getattr(lamp, "use_nodes", False):
        return np.ones(3)
    output = lamp.node_tree.get_output_node("CYCLES")
    if output is None:
        return np.ones(3)
    found = read_closure(Input(output.inputs["Surface"]))
    if found["closure"] != "emission" or values(found):
        return np.ones(3)
    return np.array(found["color"]) * found["strength"]


@dataclass
class World:
    """Reads the light from far away.

    Attributes
    ----------
    folder: where images are written.
    tell: is told when one is rendered.
    times: how many have been.
    """

    folder: Path
    tell: Callable[[str], None]
    times: int = 0
    _origin: str = ""

    def read(self, scene: Any) -> dict[str, Any] | None:
        """A constant, or an image that Cycles renders of it; None: none.

        The image is a map of all directions (EXR), (WIDTH / 2, WIDTH). Its middle is +x. The one
        from before serves again if the nodes behind it are the same.
        """
        world = scene.world
        if world is None:
            return None
        if world.node_tree is None or not getattr(world, "use_nodes", True):
            colour = list(world.color)
            return {"radiance": colour} if any(colour) else None
        output = world.node_tree.get_output_node("CYCLES")
        if output is None:
            return None
        found = read_closure(Input(output.inputs["Surface"]))
        if found["closure"] == "none":
            return None
        if found["closure"] == "emission" and not values(found):
            radiance = [c * found["strength"] for c in found["color"]]
            return {"radiance": radiance} if any(radiance) else None
        origin = f"{world.name} {plain_closure(found)} {sources(found)}"
        if origin != self._origin:
            self.tell("world")
            self.times += 1
            self._origin = origin
            _render_world(world, self.folder / f"world_{self.times}.exr")
        return {"file": f"world_{self.times}.exr"}


def _render_world(world: Any, path: Path) -> None:
    """Render all directions by Cycles, from the origin of an empty scene."""
    scene = bpy.data.scenes.new("gpf world")
    scene.world = world
    camera = bpy.data.cameras.new("gpf world")
    camera.type = "PANO"
    for owner in (camera, getattr(camera, "cycles", None)):  # moved in Blender 5.0
        if owner is not None and hasattr(owner, "panorama_type"):
            owner.panorama_type = "EQUIRECTANGULAR"
    eye = bpy.data.objects.new("gpf world", camera)
    eye.rotation_euler = (np.pi / 2, 0, -np.pi / 2)  # looks along +x, and up is +z
    scene.collection.objects.link(eye)
    scene.camera = eye
    settings = scene.render
    settings.engine = "CYCLES"
    settings.resolution_x, settings.resolution_y, settings.resolution_percentage = (
        WIDTH,
        WIDTH // 2,
        100,
    )
    # The sun of a sky is three pixels wide.
    trees = [world.node_tree, *(n.node_tree for n in world.node_tree.nodes if n.type == "GROUP")]
    has_sky = any(node.type == "TEX_SKY" for tree in trees if tree for node in tree.nodes)
    scene.cycles.samples, scene.cycles.use_denoising = 32 if has_sky else 4, False
    scene.cycles.use_adaptive_sampling = False
    scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BOX", 1.0
    scene.view_settings.view_transform = "Raw"
    save_exr(scene, path)
    bpy.data.scenes.remove(scene)
    bpy.data.objects.remove(eye)


def save_exr(scene: Any, path: Path) -> None:
    """Render a scene into a file of linear values."""
    image = scene.render.image_settings
    if hasattr(image, "media_type"):
        image.media_type = "IMAGE"
    image.file_format, image.color_mode, image.color_depth = "OPEN_EXR", "RGB", "32"
    scene.render.filepath, scene.render.use_file_extension = str(path), False
    scene.render.use_overwrite = True
    with bpy.context.temp_override(scene=scene):
        bpy.ops.render.render(write_still=True, scene=scene.name)

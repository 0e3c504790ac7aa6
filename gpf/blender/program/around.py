"""The light of worlds and lamps: what surfaces get of it, rendered by Cycles in all directions."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import bpy
import numpy as np

DIFFUSE = ("Is Diffuse Ray", "Is Reflection Ray", "Ray Depth", "Diffuse Depth")
"""What is 1 for a ray that a diffuse surface sends; all else is 0."""


def answer_as_for_surfaces(tree: Any) -> bool:
    """Replace what nodes ask about rays by the answers for diffuse surfaces; whether any asks."""
    asks = False
    for node in list(tree.nodes) if tree else ():
        if node.type == "GROUP" and node.node_tree is not None:
            node.node_tree = node.node_tree.copy()  # materials may have it, too
            asks |= answer_as_for_surfaces(node.node_tree)
        elif node.type == "LIGHT_PATH":
            for link in [link for output in node.outputs for link in output.links]:
                value = tree.nodes.new("ShaderNodeValue").outputs[0]
                value.default_value = float(link.from_socket.name in DIFFUSE)
                tree.links.new(value, link.to_socket)
                asks = True
    return asks


@contextmanager
def scene_around(width: int, samples: int) -> Iterator[Any]:
    """An empty scene whose camera, at the origin, sees all directions; +x is in the middle."""
    scene = bpy.data.scenes.new("gpf around")
    scene.frame_current = bpy.context.scene.frame_current
    camera = bpy.data.cameras.new("gpf around")
    camera.type = "PANO"
    for owner in (camera, getattr(camera, "cycles", None)):  # moved in Blender 5.0
        if owner is not None and hasattr(owner, "panorama_type"):
            owner.panorama_type = "EQUIRECTANGULAR"
    eye = bpy.data.objects.new("gpf around", camera)
    eye.rotation_euler = (np.pi / 2, 0, -np.pi / 2)  # looks along +x, and up is +z
    scene.collection.objects.link(eye)
    scene.camera = eye
    scene.render.engine = "CYCLES"
    scene.render.resolution_x, scene.render.resolution_y = width, width // 2
    scene.cycles.samples, scene.cycles.use_denoising = samples, False
    scene.cycles.use_adaptive_sampling = False
    scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BOX", 1.0
    scene.view_settings.view_transform = "Raw"
    yield scene
    for thing in list(scene.collection.objects):
        bpy.data.objects.remove(thing)
    bpy.data.scenes.remove(scene)


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

"""A scene that moves: `python animated.py FILE FRAME`, in a Python with `bpy`; saved at FRAME."""

from __future__ import annotations

import sys
from typing import Any

import bpy
from parts import add, grey, image, principled, studio, textured, tint


def key(owner: Any, name: str, values: dict[int, Any]) -> None:
    """Keyframes of a property."""
    for frame, value in values.items():
        setattr(owner, name, value)
        owner.keyframe_insert(name, frame=frame)


def patterned(name: str, socket: str = "Base Color", **values: Any) -> Any:
    """A material to bake."""
    material = principled(name, **values)
    nodes, links = material.node_tree.nodes, material.node_tree.links
    pattern = nodes.new("ShaderNodeTexChecker")
    pattern.inputs["Scale"].default_value = 4
    links.new(pattern.outputs[0], nodes["Principled BSDF"].inputs[socket])
    return material


def main(file: str, frame: str) -> None:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y = 96, 64
    scene.frame_start, scene.frame_end, scene.frame_step = 1, 9, 2
    studio()
    key(scene.camera, "location", {1: (0, -9, 4), 9: (1, -9, 4)})
    lamp = next(light for light in bpy.data.lights if light.type == "AREA")
    key(lamp, "energy", {1: 200, 9: 800})
    still = patterned("still", "Roughness")
    tint(still, textured(still, image("white", lambda x, y: (1, 1, 1))), (0.5, 0.25, 1, 1))
    add("cube", still, size=1.2, location=(-3, 0, 0.6))
    hidden = add("cube", grey(), size=0.5, location=(-1.5, -2, 0.25))
    key(hidden, "hide_render", {1: False, 7: True})
    paint = principled("paint", Roughness=0.8)
    key(
        paint.node_tree.nodes["Principled BSDF"].inputs[0],
        "default_value",
        {1: (0.7, 0.1, 0.1, 1), 9: (0.1, 0.7, 0.1, 1)},
    )
    moving = add("cube", paint, size=0.8, location=(-1, 0, 0.4))
    key(moving, "location", {1: (-1, 0, 0.4), 9: (-1, -1, 1)})
    water = patterned("water", Roughness=0.8)
    sheet = add("grid", water, True, x_subdivisions=20, y_subdivisions=20, size=2.5)
    sheet.location = (1.7, 0, 0.7)
    sheet.modifiers.new("wave", "WAVE").height = 0.4
    sheet.modifiers.new("smooth", "SUBSURF").render_levels = 2
    spikes = add("grid", grey(), x_subdivisions=10, y_subdivisions=10, size=1)
    spikes.location = (0, 1.5, 1)
    spikes.shape_key_add(name="flat")
    high = spikes.shape_key_add(name="high")
    for number, point in enumerate(high.data):
        point.co.z = 0.5 * (number % 7 / 7) ** 2
    key(high, "value", {1: 0.0, 9: 1.0})
    boiling = patterned("boiling", Roughness=0.9)
    pattern = boiling.node_tree.nodes["Checker Texture"]
    key(pattern.inputs["Scale"], "default_value", {7: 4.0, 9: 8.0})
    bpy.ops.curve.primitive_bezier_circle_add(radius=0.5, location=(3.5, 0, 0.2))
    bpy.context.object.data.bevel_depth = 0.2
    bpy.context.object.data.materials.append(boiling)
    scene.frame_set(int(frame))
    if file.endswith(".glb"):
        bpy.ops.export_scene.gltf(filepath=file, export_cameras=True)
    else:
        bpy.ops.wm.save_as_mainfile(filepath=file)


if __name__ == "__main__":
    main(*sys.argv[-2:])

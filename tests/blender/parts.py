"""What the scenes of made.py are put together from: materials, objects, lamps, cameras, images."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import bpy


def principled(name: str, **values: Any) -> Any:
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    node = material.node_tree.nodes["Principled BSDF"]
    for key, value in values.items():
        node.inputs[key.replace("_", " ")].default_value = value
    return material


def shader(name: str, kind: str, **values: Any) -> Any:
    """A material of one node, such as "Glass" or "Diffuse"."""
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    nodes = material.node_tree.nodes
    nodes.clear()
    node = nodes.new(kind)
    for key, value in values.items():
        node.inputs[key.replace("_", " ")].default_value = value
    output = nodes.new("ShaderNodeOutputMaterial")
    material.node_tree.links.new(node.outputs[0], output.inputs[0])
    return material


def add(kind: str, material: Any = None, smooth: bool = False, **where: Any) -> Any:
    getattr(bpy.ops.mesh, f"primitive_{kind}_add")(**where)
    thing = bpy.context.object
    if material is not None:
        thing.data.materials.append(material)
    if smooth:
        bpy.ops.object.shade_smooth()
    return thing


def lamp(kind: str, energy: float, **settings: Any) -> Any:
    where = {key: settings.pop(key) for key in ("location", "rotation") if key in settings}
    bpy.ops.object.light_add(type=kind, **where)
    data = bpy.context.object.data
    data.energy = energy
    for key, value in settings.items():
        setattr(data, key, value)
    return bpy.context.object


def camera(location: Any, tilt: float, lens: float = 45, turn: float = 0) -> Any:
    bpy.ops.object.camera_add(
        location=location, rotation=(math.radians(tilt), 0, math.radians(turn))
    )
    bpy.context.object.data.lens = lens
    bpy.context.scene.camera = bpy.context.object
    return bpy.context.object


def world(*colour: float) -> None:
    found = bpy.data.worlds.new("world")
    bpy.context.scene.world = found
    found.use_nodes = True
    found.node_tree.nodes["Background"].inputs[0].default_value = (*colour, 1)


def image(
    name: str,
    pixels: Callable[[float, float], Any],
    size: tuple[int, int] = (64, 64),
    space: str = "sRGB",
) -> Any:
    width, height = size
    made = bpy.data.images.new(name, width, height)
    made.colorspace_settings.name = space
    values = []
    for y in range(height):
        for x in range(width):
            values += [*pixels((x + 0.5) / width, (y + 0.5) / height), 1.0][:4]
    made.pixels = values
    made.pack()
    return made


def textured(material: Any, made: Any, socket: str = "Base Color") -> Any:
    nodes, links = material.node_tree.nodes, material.node_tree.links
    node = nodes.new("ShaderNodeTexImage")
    node.image = made
    links.new(node.outputs[0], nodes["Principled BSDF"].inputs[socket])
    return node


def tint(material: Any, made: Any, colour: tuple[float, ...]) -> None:
    """Multiply an image by a colour, as Blender reads the factors of glTF."""
    nodes, links = material.node_tree.nodes, material.node_tree.links
    mix = nodes.new("ShaderNodeMix")
    mix.data_type, mix.blend_type = "RGBA", "MULTIPLY"
    mix.inputs["Factor"].default_value = 1
    first, second = (s for s in mix.inputs if s.type == "RGBA")
    links.new(made.outputs[0], first)
    second.default_value = colour
    result = next(s for s in mix.outputs if s.type == "RGBA")
    links.new(result, nodes["Principled BSDF"].inputs["Base Color"])


def grey() -> Any:
    return shader("grey", "ShaderNodeBsdfDiffuse", Color=(0.6, 0.6, 0.6, 1))


def studio() -> None:
    """A floor under a lamp and a sky, and a camera."""
    add("plane", grey(), size=12)
    lamp("AREA", 400, location=(2, -3, 5), rotation=(0.5, 0.3, 0), size=1.5)
    world(0.3, 0.35, 0.4)
    camera((0, -9, 4), 68)


def volume(material: Any, kind: str, **values: Any) -> Any:
    """Give a material a volume shader."""
    tree = material.node_tree
    node = tree.nodes.new(kind)
    for name, value in values.items():
        node.inputs[name.replace("_", " ")].default_value = value
    output = next(n for n in tree.nodes if n.type == "OUTPUT_MATERIAL")
    tree.links.new(node.outputs[0], output.inputs["Volume"])
    return material


def linked(tree: Any, kind: str, inputs: dict[str, Any]) -> Any:
    """A new node; its inputs are values or outputs of other nodes."""
    node = tree.nodes.new(kind)
    for name, value in inputs.items():
        if isinstance(value, bpy.types.NodeSocket):
            tree.links.new(value, node.inputs[name])
        else:
            node.inputs[name].default_value = value
    return node


def checks(name: str, *dark: float) -> Any:
    """A material to bake: squares in two colours."""
    material = shader(name, "ShaderNodeBsdfDiffuse")
    nodes, links = material.node_tree.nodes, material.node_tree.links
    pattern = nodes.new("ShaderNodeTexChecker")
    pattern.inputs["Color2"].default_value = (*dark, 1)
    pattern.inputs["Scale"].default_value = 3
    links.new(pattern.outputs[0], nodes["Diffuse BSDF"].inputs[0])
    return material


def paint(name: str, *colour: float) -> Any:
    return shader(name, "ShaderNodeBsdfDiffuse", Color=(*colour, 1))

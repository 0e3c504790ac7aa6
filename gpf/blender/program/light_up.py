"""A scene in its baked light as a .blend file: `python light_up.py FOLDER FILE.blend`.

The folder has ``scene.glb``, whose lit materials have extras, and ``light.json``: the exposure, and
the image of each group of lights, π times radiance for a white surface. All lit materials show what
the node group "Baked Light" gives; its values dim and colour the lamps.
"""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Any

import bpy

GROUP = "Baked Light"


def main(folder: Path, file: Path) -> int:
    """The program."""
    facts = json.loads((folder / "light.json").read_text(encoding="utf-8"))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    print("gpf: reading the scene", flush=True)
    bpy.ops.import_scene.gltf(filepath=str(folder / "scene.glb"))
    coordinates = "UVMap.001"
    group = light_of(facts["lights"], folder, coordinates)
    for material in bpy.data.materials:
        if material.get("baked"):
            light_up(material, group)
    scene = bpy.context.scene
    if facts["sky"]:
        scene.world = sky_of(folder / facts["sky"])
    scene.view_settings.view_transform = "Standard"
    scene.view_settings.exposure = math.log2(facts["exposure"])
    scene.render.resolution_x, scene.render.resolution_y = facts["size"]
    scene.camera = next((o for o in scene.objects if o.type == "CAMERA"), None)
    bpy.ops.file.pack_all()
    print("gpf: writing", flush=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(file), compress=True)
    return 0


def light_of(lights: dict[str, str], folder: Path, coordinates: str) -> Any:
    """A node group with the sum of all lights, each times its level and its colour, over π."""
    tree = bpy.data.node_groups.new(GROUP, "ShaderNodeTree")
    tree.interface.new_socket("Light", in_out="OUTPUT", socket_type="NodeSocketColor")
    place = tree.nodes.new("ShaderNodeUVMap")
    place.uv_map, place.location = coordinates, (-900, 0)
    total: Any = None
    for number, (name, file) in enumerate(lights.items()):
        picture = tree.nodes.new("ShaderNodeTexImage")
        picture.image = bpy.data.images.load(str(folder / file))
        picture.label, picture.location = name or "All Lamps", (-650, -300 * number)
        tree.links.new(place.outputs[0], picture.inputs["Vector"])
        colour = product(tree, picture.outputs[0], None, (-350, -300 * number))
        colour.label = f"Colour of {picture.label}"
        level = tree.nodes.new("ShaderNodeVectorMath")
        level.operation, level.label = "SCALE", f"Level of {picture.label}"
        level.inputs["Scale"].default_value, level.location = 1, (-150, -300 * number)
        tree.links.new(result_of(colour), level.inputs[0])
        if total is None:
            total = level
            continue
        both = tree.nodes.new("ShaderNodeVectorMath")
        both.operation, both.location = "ADD", (50, -300 * number)
        tree.links.new(total.outputs[0], both.inputs[0])
        tree.links.new(level.outputs[0], both.inputs[1])
        total = both
    radiance = tree.nodes.new("ShaderNodeVectorMath")
    radiance.operation, radiance.location = "SCALE", (250, 0)
    radiance.inputs["Scale"].default_value = 1 / math.pi
    end = tree.nodes.new("NodeGroupOutput")
    end.location = (450, 0)
    tree.links.new(total.outputs[0], radiance.inputs[0])
    tree.links.new(radiance.outputs[0], end.inputs[0])
    return tree


def sky_of(file: Path) -> Any:
    """A world with a picture of all directions; its level is the strength of the background."""
    world = bpy.data.worlds.new("Sky")
    nodes, links = world.node_tree.nodes, world.node_tree.links
    background = next(node for node in nodes if node.type == "BACKGROUND")
    picture = nodes.new("ShaderNodeTexEnvironment")
    picture.image, picture.location = bpy.data.images.load(str(file)), (-300, 300)
    links.new(picture.outputs[0], background.inputs["Color"])
    return world


def light_up(material: Any, group: Any) -> None:
    """Have a material emit its colour times the light, and reflect if it is glossy."""
    tree = material.node_tree
    image = next((n.image for n in tree.nodes if n.type == "TEX_IMAGE" and n.image), None)
    tree.nodes.clear()
    end, emission = (tree.nodes.new(f"ShaderNode{n}") for n in ("OutputMaterial", "Emission"))
    light = tree.nodes.new("ShaderNodeGroup")
    light.node_tree = group
    shown = product(tree, light.outputs[0], list(material["factor"]), (-400, 0))
    light.location, emission.location, end.location = (-600, 0), (100, 0), (500, 0)
    if image is not None:
        place, picture = (tree.nodes.new(f"ShaderNode{n}") for n in ("UVMap", "TexImage"))
        place.uv_map, picture.image = "UVMap", image
        place.location, picture.location = (-800, -300), (-600, -300)
        tree.links.new(place.outputs[0], picture.inputs["Vector"])
        both = product(tree, result_of(shown), None, (-150, 0))
        tree.links.new(picture.outputs[0], colours_of(both)[1])
        shown = both
    tree.links.new(result_of(shown), emission.inputs["Color"])
    surface = emission
    if material["gloss"] >= 0:
        names = ("Fresnel", "BsdfGlossy", "MixShader")
        fresnel, gloss, surface = (tree.nodes.new(f"ShaderNode{n}") for n in names)
        gloss.inputs["Roughness"].default_value = material["gloss"]
        gloss.location, fresnel.location, surface.location = (100, -200), (100, 200), (300, 0)
        for output, place in zip((fresnel, emission, gloss), surface.inputs, strict=True):
            tree.links.new(output.outputs[0], place)
    tree.links.new(surface.outputs[0], end.inputs["Surface"])


def product(tree: Any, first: Any, second: list[float] | None, place: tuple[int, int]) -> Any:
    """A node that multiplies a colour by another one, or by white."""
    node = tree.nodes.new("ShaderNodeMix")
    node.data_type, node.blend_type, node.location = "RGBA", "MULTIPLY", place
    node.inputs["Factor"].default_value = 1
    tree.links.new(first, colours_of(node)[0])
    colours_of(node)[1].default_value = [*(second or [1, 1, 1]), 1]
    return node


def colours_of(node: Any) -> list[Any]:
    """The two colours that a node multiplies."""
    return [socket for socket in node.inputs if socket.type == "RGBA"]


def result_of(node: Any) -> Any:
    """Their product."""
    return next(socket for socket in node.outputs if socket.type == "RGBA")


if __name__ == "__main__":
    arguments = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    sys.exit(main(*(Path(word).resolve() for word in arguments)))

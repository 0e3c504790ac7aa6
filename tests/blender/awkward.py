"""Scenes with what people's files have: `python awkward.py NAME FILE`, in a Python with `bpy`."""

from __future__ import annotations

import sys
from typing import Any

import bpy
from made import SCENES, scene
from parts import (
    add,
    camera,
    checks,
    grey,
    image,
    lamp,
    linked,
    paint,
    principled,
    shader,
    studio,
    textured,
    world,
)


def empty_nodes(thing: Any) -> tuple[Any, Any]:
    """Give an object geometry nodes; their tree, and the geometry that they get."""
    tree = bpy.data.node_groups.new("nodes", "GeometryNodeTree")
    for way in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=way, socket_type="NodeSocketGeometry")
    thing.modifiers.new("nodes", "NODES").node_group = tree
    return tree, tree.nodes.new("NodeGroupInput").outputs[0]


@scene
def layers() -> None:
    """Two view layers; the second one is without the cube."""
    studio()
    add("cube", paint("red", 0.7, 0.1, 0.1), location=(0, 0, 1))
    group = bpy.data.collections.new("cubes")
    bpy.context.scene.collection.children.link(group)
    group.objects.link(bpy.context.object)
    bpy.context.scene.collection.objects.unlink(bpy.context.object)
    bpy.context.scene.view_layers.new("other").layer_collection.children["cubes"].exclude = True


@scene
def slots() -> None:
    """Materials of geometry nodes, of a slot of the object itself, of a source that is hidden, and
    of two meshes that are generated; some are patterns."""
    studio()
    own = add("plane", paint("of the mesh", 0.1, 0.1, 0.8), size=3, location=(-3, 0, 0.05))
    own.material_slots[0].link = "OBJECT"
    own.material_slots[0].material = paint("of the object", 0.1, 0.7, 0.1)
    source = add("cube", paint("hidden", 0.8, 0.6, 0.1), size=0.6, location=(9, 9, 9))
    source.hide_render = True
    thing = add("plane", paint("before", 0.1, 0.1, 0.8), size=3, location=(1, 0, 0.05))
    tree, start = empty_nodes(thing)
    patterned = {"Geometry": start, "Material": checks("set", 0.6, 0.05, 0.05)}
    red = linked(tree, "GeometryNodeSetMaterial", patterned)
    info = linked(tree, "GeometryNodeObjectInfo", {"Object": source, "As Instance": True})
    ball = tree.nodes.new("GeometryNodeMeshUVSphere")
    for name, value in (("Radius", 0.5), ("Segments", 200), ("Rings", 100)):  # enough to be copies
        ball.inputs[name].default_value = value
    patterned = {"Geometry": ball.outputs[0], "Material": checks("ball", 0.05, 0.5, 0.5)}
    ball = linked(tree, "GeometryNodeSetMaterial", patterned)
    rod = linked(tree, "GeometryNodeMeshCylinder", {"Vertices": 4000, "Radius": 0.2, "Depth": 3.0})
    painted = {"Geometry": rod.outputs[0], "Material": paint("rod", 0.6, 0.1, 0.6)}
    rod = linked(tree, "GeometryNodeSetMaterial", painted)
    every = linked(tree, "GeometryNodeJoinGeometry", {"Geometry": red.outputs[0]})
    for number, made_here in enumerate((info, ball, rod)):
        what = {"Points": start, "Instance": made_here.outputs["Geometry"]}
        copies = linked(tree, "GeometryNodeInstanceOnPoints", what)
        moved = {"Geometry": copies.outputs[0], "Translation": (0.2, 0.5 * number, 0.4)}
        moved = linked(tree, "GeometryNodeTransform", moved)
        tree.links.new(moved.outputs[0], every.inputs[0])
    tree.links.new(every.outputs[0], tree.nodes.new("NodeGroupOutput").inputs[0])


@scene
def skies() -> None:
    """A world whose light the camera does not see; what asks for rays is in a group."""
    studio()
    bpy.data.objects.remove(next(o for o in bpy.data.objects if o.type == "LIGHT"))
    camera((0, -3, 5), 20)
    world(0, 0, 0)
    tree = bpy.context.scene.world.node_tree
    group = bpy.data.node_groups.new("rays", "ShaderNodeTree")
    group.interface.new_socket("Seen", in_out="OUTPUT", socket_type="NodeSocketFloat")
    seen = group.nodes.new("ShaderNodeLightPath").outputs["Is Camera Ray"]
    group.links.new(seen, group.nodes.new("NodeGroupOutput").inputs[0])
    inside = tree.nodes.new("ShaderNodeGroup")
    inside.node_tree = group
    light = tree.nodes.new("ShaderNodeBackground")
    light.inputs[0].default_value = (0.3, 0.6, 1, 1)
    mix = linked(tree, "ShaderNodeMixShader", {"Factor": inside.outputs[0]})
    tree.links.new(light.outputs[0], mix.inputs[1])
    tree.links.new(tree.nodes["Background"].outputs[0], mix.inputs[2])
    tree.links.new(mix.outputs[0], tree.nodes["World Output"].inputs["Surface"])


@scene
def misty() -> None:
    """A world with a volume, a lens that blurs, an exposure, and an object without a good name."""
    studio()
    scene = bpy.context.scene
    scene.view_settings.exposure = 1
    scene.camera.data.dof.use_dof = True
    tree = scene.world.node_tree
    mist = linked(tree, "ShaderNodeVolumeScatter", {"Density": 0.1})
    tree.links.new(mist.outputs[0], tree.nodes["World Output"].inputs["Volume"])
    add("cube", grey()).name = "id"


@scene
def filters() -> None:
    """Lamps with nodes, one for each channel: a temperature, a gobo, and a factor."""
    add("plane", grey(), size=30)
    camera((0, -0.3, 1.8), 8, lens=20)
    world(0, 0, 0)
    for kind, x, colour in (("POINT", -2, "r"), ("SPOT", 0.8, "g"), ("AREA", -0.5, "b")):
        data = lamp(kind, 200, location=(x, 0, 3)).data
        data.color = [float(colour == c) for c in "rgb"]
        data.use_nodes = True
        tree = data.node_tree
        emission = tree.nodes["Emission"]
        if kind == "POINT":
            warm = linked(tree, "ShaderNodeBlackbody", {"Temperature": 2500.0})
            tree.links.new(warm.outputs[0], emission.inputs[0])
        elif kind == "SPOT":
            data.spot_blend = 0
            around = tree.nodes.new("ShaderNodeTexCoord").outputs["Normal"]
            pattern = linked(tree, "ShaderNodeTexChecker", {"Vector": around, "Scale": 40.0})
            tree.links.new(pattern.outputs[0], emission.inputs[0])
        else:
            emission.inputs[1].default_value = 0.5


@scene
def sizes() -> None:
    """Lamps whose power is for each unit of their size, one for each channel."""
    add("plane", grey(), size=30)
    camera((0, -0.3, 1.8), 8, lens=20)
    area = lamp("AREA", 30, location=(0, 4, 3), color=(1, 0, 0), size=2, shape="DISK")
    area.scale = (1, 0.5, 3)
    lamp("POINT", 300, location=(-2, 0, 2), color=(0, 1, 0), shadow_soft_size=0.2)
    lamp("SUN", 50, color=(0, 0, 1), angle=0.2)
    for light in bpy.data.lights:
        light.normalize = False


@scene
def points() -> None:
    """The same for lamps without a size; and lamps that are dark, as they are scaled to nothing."""
    add("plane", grey(), size=30)
    camera((0, -0.3, 1.8), 8, lens=20)
    lamp("POINT", 30, location=(-2, 0, 2), color=(1, 0, 0), shadow_soft_size=0)
    lamp("SPOT", 50, location=(0.8, 0, 3), color=(0, 1, 0), shadow_soft_size=0, spot_blend=0)
    lamp("SUN", 0.5, color=(0, 0, 1), angle=0)
    for light in bpy.data.lights:
        light.normalize = False
    for kind in ("SUN", "AREA", "SPOT"):
        lamp(kind, 10, location=(0, 0, 3)).scale = (0, 0, 0)


@scene
def leaf() -> None:
    """Pictures that are not square, to be baked, and a black emission."""
    studio()
    made = principled("leaf", Roughness=1, Specular_IOR_Level=0)
    node = textured(made, image("stripes", lambda x, y: [0.8, y, 0.1], size=(16, 256)))
    made.node_tree.links.new(
        made.node_tree.nodes.new("ShaderNodeTexCoord").outputs["Generated"], node.inputs[0]
    )
    made.node_tree.nodes.active = node  # by whose picture Blender would stretch coordinates
    cut = lambda x, y: [float(int(128 * y) % 2)] * 3  # noqa: E731
    textured(made, image("cut", cut, size=(16, 256), space="Non-Color"), "Alpha")
    made.node_tree.nodes["Principled BSDF"].inputs["Emission Color"].default_value = (0, 0, 0, 1)
    made.node_tree.nodes["Principled BSDF"].inputs["Emission Strength"].default_value = 1
    add("plane", made, size=3, location=(0, 0, 1.5), rotation=(1, 0, 0)).data.polygons.active = 0


@scene
def sums() -> None:
    """Two surfaces on top of each other."""
    studio()
    warm, cold = ((0.5, 0.2, 0.1, 1), (0.1, 0.4, 0.4, 1)), ((0.6, 0.6, 0.6, 1), (0.2, 0.2, 0.3, 1))
    for x, (first, second) in ((-1.5, warm), (1.5, cold)):
        material = shader("sum", "ShaderNodeBsdfDiffuse", Color=first)
        tree = material.node_tree
        shine = {"Color": second, "Roughness": 0.3}
        shine = linked(tree, "ShaderNodeBsdfAnisotropic", shine)
        both = tree.nodes.new("ShaderNodeAddShader")
        for place, node in zip(both.inputs, (tree.nodes["Diffuse BSDF"], shine), strict=True):
            tree.links.new(node.outputs[0], place)
        tree.links.new(both.outputs[0], tree.nodes["Material Output"].inputs[0])
        add("uv_sphere", material, True, radius=1.2, location=(x, 0, 1.2), segments=64)


@scene
def hidden() -> None:
    """Patterns on what the viewport does not show, and on a mesh without faces."""
    studio()
    for k, way in enumerate(("hide_viewport", "exclude", "the eye", "the object", "in the scene")):
        thing = add("cube", checks(way, 0.1, 0.2 * k, 0.5), location=(1.4 * k - 3, 0, 0.5), size=1)
        group = bpy.data.collections.new(way)
        bpy.context.scene.collection.children.link(group)
        group.objects.link(thing)
        if k < 4:
            bpy.context.scene.collection.objects.unlink(thing)
        layer = bpy.context.view_layer.layer_collection.children[way]
        if way == "hide_viewport":
            group.hide_viewport = True
        elif way == "exclude":
            layer.exclude = True
        elif way == "the eye":
            layer.hide_viewport = True
        else:
            thing.hide_viewport = True
    thing = bpy.data.objects.new("empty", bpy.data.meshes.new("empty"))
    bpy.context.scene.collection.objects.link(thing)
    thing.data.materials.append(checks("no faces", 0, 0, 0))


@scene
def glowing() -> None:
    """A sun and a lamp, for other formats."""
    studio()
    lamp("SUN", 2, rotation=(0.7, 0.3, 0.5))


def main(name: str, file: str) -> None:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.scene.render.resolution_x, bpy.context.scene.render.resolution_y = 96, 64
    SCENES[name]()
    if file.endswith(".glb"):
        bpy.ops.export_scene.gltf(filepath=file, export_lights=True)
    elif file.endswith(".fbx"):
        bpy.ops.export_scene.fbx(filepath=file)
    else:
        bpy.ops.wm.save_as_mainfile(filepath=file)


if __name__ == "__main__":
    main(*sys.argv[-2:])

"""Scenes that Blender makes and saves: `python made.py NAME FILE`, in a Python with `bpy`."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable

import bpy
from parts import (
    add,
    camera,
    grey,
    image,
    lamp,
    principled,
    shader,
    studio,
    textured,
    tint,
    volume,
    world,
)

SCENES: dict[str, Callable[[], None]] = {}


def scene(make: Callable[[], None]) -> Callable[[], None]:
    SCENES[make.__name__] = make
    return make


@scene
def lamps() -> None:
    add("plane", grey(), size=12)
    add("uv_sphere", grey(), smooth=True, radius=0.8, location=(-1.5, 0, 0.8))
    lamp("POINT", 200, location=(-3, -1, 2), color=(1, 0.5, 0.2), shadow_soft_size=0.3)
    lamp("POINT", 60, location=(1, -2, 2.5), shadow_soft_size=0)
    lamp("SPOT", 500, location=(3, -2, 4), rotation=(0.4, 0.4, 0), shadow_soft_size=0, spot_blend=0)
    lamp("AREA", 100, location=(0, 3, 3), rotation=(-0.8, 0, 0), shape="ELLIPSE", size=2, size_y=1)
    lamp("SUN", 0.5, rotation=(0.7, 0.3, 0.5), angle=0.1)
    camera((0, -9, 4), 68)


@scene
def materials() -> None:
    studio()
    rows = [
        principled("matte", Base_Color=(0.6, 0.3, 0.1, 1), Roughness=0.9),
        principled("lacquer", Base_Color=(0.1, 0.2, 0.6, 1), Roughness=0.05),
        principled("gold", Base_Color=(1, 0.77, 0.34, 1), Metallic=1, Roughness=0.25),
        shader("glass", "ShaderNodeBsdfGlass", Color=(0.9, 1, 0.95, 1), Roughness=0.0, IOR=1.45),
        principled("frosted", Transmission_Weight=1, Roughness=0.2, IOR=1.45),
        shader("mirror", "ShaderNodeBsdfAnisotropic", Color=(0.9, 0.9, 0.9, 1), Roughness=0.0),
        shader("leaf", "ShaderNodeBsdfTranslucent", Color=(0.3, 0.7, 0.2, 1)),
        principled("glow", Emission_Color=(1, 0.4, 0.1, 1), Emission_Strength=2),
    ]
    for k, material in enumerate(rows):
        place = (1.4 * (k % 4) - 2.1, 1.5 * (k // 4) - 1, 0.55)
        add("uv_sphere", material, True, radius=0.5, location=place, segments=64, ring_count=32)


@scene
def textures() -> None:
    studio()
    red = lambda x, y: (0.9 * x, 0.8 * y, 0.1)  # noqa: E731
    plain = principled("image", Roughness=1, Specular_IOR_Level=0)
    node = textured(plain, image("ramp", red))
    tint(plain, node, (0.9, 0.6, 1, 1))
    add("cube", plain, size=1.4, location=(-2.5, 0, 0.7))
    turned = principled("mapped", Roughness=1, Specular_IOR_Level=0)
    node = textured(turned, image("ramp2", red))
    nodes, links = turned.node_tree.nodes, turned.node_tree.links
    place, mapping = nodes.new("ShaderNodeTexCoord"), nodes.new("ShaderNodeMapping")
    mapping.inputs["Location"].default_value = (0.2, 0.1, 0)
    mapping.inputs["Rotation"].default_value = (0, 0, 0.4)
    mapping.inputs["Scale"].default_value = (2, 3, 1)
    links.new(place.outputs["UV"], mapping.inputs[0])
    links.new(mapping.outputs[0], node.inputs[0])
    add("plane", turned, size=2, location=(0, 1, 1), rotation=(math.pi / 2, 0, 0))
    rough = principled("rough", Base_Color=(0.3, 0.3, 0.8, 1))
    textured(
        rough,
        image("stripes", lambda x, y: [0.15 + 0.6 * (int(8 * x) % 2)] * 3, space="Non-Color"),
        "Roughness",
    )
    add("uv_sphere", rough, True, radius=0.8, location=(2.5, 0, 0.8))
    painted = principled("painted", Roughness=1, Specular_IOR_Level=0)
    node = painted.node_tree.nodes.new("ShaderNodeVertexColor")
    node.layer_name = "Colours"
    painted.node_tree.links.new(
        node.outputs[0], painted.node_tree.nodes["Principled BSDF"].inputs["Base Color"]
    )
    thing = add(
        "grid", painted, x_subdivisions=8, y_subdivisions=8, size=1.5, location=(0, -2, 0.02)
    )
    colours = thing.data.color_attributes.new("Colours", "FLOAT_COLOR", "POINT")
    for vertex, value in zip(thing.data.vertices, colours.data, strict=True):
        value.color = (0.5 + 0.6 * vertex.co.x, 0.5 + 0.6 * vertex.co.y, 0.3, 1)


@scene
def baked() -> None:
    """Node trees that Mitsuba has no words for, one of them in a group."""
    studio()
    checker = principled("checker", Roughness=0.6)
    nodes, links = checker.node_tree.nodes, checker.node_tree.links
    group = bpy.data.node_groups.new("pattern", "ShaderNodeTree")
    group.interface.new_socket("Scale", in_out="INPUT", socket_type="NodeSocketFloat")
    group.interface.new_socket("Color", in_out="OUTPUT", socket_type="NodeSocketColor")
    start, end = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
    pattern = group.nodes.new("ShaderNodeTexChecker")
    pattern.inputs["Color1"].default_value = (0.8, 0.7, 0.1, 1)
    pattern.inputs["Color2"].default_value = (0.1, 0.2, 0.6, 1)
    group.links.new(start.outputs["Scale"], pattern.inputs["Scale"])
    group.links.new(pattern.outputs["Color"], end.inputs["Color"])
    node = nodes.new("ShaderNodeGroup")
    node.node_tree = group
    node.inputs["Scale"].default_value = 4
    links.new(node.outputs["Color"], nodes["Principled BSDF"].inputs["Base Color"])
    add("cube", checker, size=1.5, location=(-2.2, 0, 0.75))
    stone = principled("stone", Roughness=0.8)
    nodes, links = stone.node_tree.nodes, stone.node_tree.links
    noise, ramp = nodes.new("ShaderNodeTexNoise"), nodes.new("ShaderNodeValToRGB")
    noise.inputs["Scale"].default_value = 3
    ramp.color_ramp.elements[0].color = (0.1, 0.3, 0.1, 1)
    ramp.color_ramp.elements[1].color = (0.9, 0.6, 0.5, 1)
    links.new(noise.outputs[0], ramp.inputs[0])
    links.new(ramp.outputs[0], nodes["Principled BSDF"].inputs["Base Color"])
    thing = add("monkey", stone, True, size=1.6, location=(0.2, 0, 1))
    thing.modifiers.new("smooth", "SUBSURF").render_levels = 2
    bumpy = principled("bumpy", Base_Color=(0.5, 0.5, 0.5, 1), Roughness=0.7)
    nodes, links = bumpy.node_tree.nodes, bumpy.node_tree.links
    wave, bump = nodes.new("ShaderNodeTexWave"), nodes.new("ShaderNodeBump")
    wave.inputs["Scale"].default_value = 2
    bump.inputs["Strength"].default_value = 0.5
    links.new(wave.outputs[1], bump.inputs["Height"])
    links.new(bump.outputs[0], nodes["Principled BSDF"].inputs["Normal"])
    add("uv_sphere", bumpy, True, radius=0.9, location=(2.3, 0, 0.9), segments=64, ring_count=32)


@scene
def cutouts() -> None:
    """Alpha, mixtures, and sheets that shine on both sides."""
    studio()
    leaf = principled("leaf", Base_Color=(0.2, 0.6, 0.1, 1), Roughness=1, Specular_IOR_Level=0)
    disc = lambda x, y: [1.0 if (x - 0.5) ** 2 + (y - 0.5) ** 2 < 0.16 else 0.0] * 3  # noqa: E731
    textured(leaf, image("disc", disc, space="Non-Color"), "Alpha")
    add("plane", leaf, size=1.8, location=(-2.4, 0, 1), rotation=(math.pi / 2, 0, 0))
    half = shader("half", "ShaderNodeBsdfDiffuse", Color=(0.8, 0.1, 0.1, 1))
    nodes, links = half.node_tree.nodes, half.node_tree.links
    mix, clear = nodes.new("ShaderNodeMixShader"), nodes.new("ShaderNodeBsdfTransparent")
    mix.inputs[0].default_value = 0.4
    links.new(nodes["Diffuse BSDF"].outputs[0], mix.inputs[1])
    links.new(clear.outputs[0], mix.inputs[2])
    links.new(mix.outputs[0], nodes["Material Output"].inputs[0])
    add("plane", half, size=1.5, location=(0, 0.5, 1), rotation=(math.pi / 2, 0, 0.3))
    sheet = shader("sheet", "ShaderNodeEmission", Color=(0.3, 0.6, 1, 1), Strength=3)
    add("plane", sheet, size=1, location=(2.4, 0.5, 1), rotation=(math.pi / 2, 0, 1.2))


@scene
def copies() -> None:
    """Instances, a mirrored one, text, a curve, and two materials on a mesh."""
    studio()
    gold = principled("gold", Base_Color=(0.9, 0.7, 0.3, 1), Metallic=1, Roughness=0.3)
    source = add("monkey", gold, True, size=0.7, location=(0, 0, 50))
    source.modifiers.new("smooth", "SUBSURF").render_levels = 3
    group = bpy.data.collections.new("heads")
    group.objects.link(source)
    bpy.context.scene.collection.children.link(group)
    bpy.context.view_layer.layer_collection.children["heads"].exclude = True
    for k in range(5):
        bpy.ops.object.collection_instance_add(
            collection="heads", location=(1.2 * k - 2.4, 1, -49.5)
        )
    bpy.context.object.scale.x = -1
    blue = principled("blue", Base_Color=(0.1, 0.2, 0.7, 1), Roughness=0.5)
    bpy.ops.object.text_add(location=(-2.5, -1.5, 0.05), rotation=(0.6, 0, 0))
    bpy.context.object.data.body, bpy.context.object.data.extrude = "Photon", 0.08
    bpy.context.object.data.materials.append(blue)
    bpy.ops.curve.primitive_bezier_circle_add(radius=0.6, location=(1.8, -1.2, 0.3))
    bpy.context.object.data.bevel_depth = 0.15
    bpy.context.object.data.materials.append(blue)
    thing = add("cube", blue, size=0.8, location=(0.6, -1.2, 0.4))
    thing.data.materials.append(principled("white", Base_Color=(0.9, 0.9, 0.9, 1), Roughness=0.9))
    for polygon in list(thing.data.polygons)[::2]:
        polygon.material_index = 1


@scene
def eye() -> None:
    """A camera with a shift, in a high picture, that moves over 24 frames."""
    studio()
    add("cube", principled("red", Base_Color=(0.7, 0.1, 0.1, 1)), size=1.5, location=(0, 0, 0.75))
    thing = bpy.context.scene.camera
    thing.data.shift_x, thing.data.shift_y = 0.1, -0.15
    bpy.context.scene.frame_end = 24
    for frame, x in ((1, 0.0), (24, 3.0)):
        thing.location.x = x
        thing.keyframe_insert("location", frame=frame)


@scene
def skylight() -> None:
    add("plane", grey(), size=12)
    add("uv_sphere", grey(), smooth=True, radius=0.8, location=(-1.5, 0, 0.8))
    add(
        "cube",
        principled("red", Base_Color=(0.7, 0.1, 0.1, 1), Roughness=0.6),
        size=1.2,
        location=(1.5, 0.5, 0.6),
    )
    world(0, 0, 0)
    tree = bpy.context.scene.world.node_tree
    sky = tree.nodes.new("ShaderNodeTexSky")
    kinds = [item.identifier for item in sky.bl_rna.properties["sky_type"].enum_items]
    sky.sky_type = next(k for k in ("MULTIPLE_SCATTERING", "NISHITA") if k in kinds)
    sky.sun_rotation, sky.sun_elevation = 2.2, 0.6
    tree.links.new(sky.outputs[0], tree.nodes["Background"].inputs[0])
    tree.nodes["Background"].inputs[1].default_value = 0.1
    camera((0, -9, 4), 68)


@scene
def pool() -> None:
    """Water in a basin, and light that it focuses."""
    tiles = principled("tiles", Base_Color=(0.5, 0.7, 0.75, 1), Roughness=0.8, Specular_IOR_Level=0)
    for size, place in (((3, 3, 0.1), (0, 0, -1.5)), ((0.1, 3, 1.6), (-1.5, 0, -0.75))):
        add("cube", tiles, size=1, scale=size, location=place)
    add("cube", tiles, size=1, scale=(0.1, 3, 1.6), location=(1.5, 0, -0.75))
    for y in (-1.5, 1.5):
        add("cube", tiles, size=1, scale=(3, 0.1, 1.6), location=(0, y, -0.75))
    water = shader("water", "ShaderNodeBsdfGlass", Color=(1, 1, 1, 1), Roughness=0.0, IOR=1.33)
    thing = add("grid", water, True, x_subdivisions=120, y_subdivisions=120, size=3)
    for vertex in thing.data.vertices:
        x, y, _ = vertex.co
        vertex.co.z = 0.03 * math.sin(7 * x + 2 * y) + 0.03 * math.sin(4 * y - 5 * x) - 0.1
    lamp("AREA", 300, location=(0.5, -0.5, 3), size=1.5)
    world(0.02, 0.02, 0.03)
    camera((0, -4.5, 2.6), 58, 35)


@scene
def room() -> None:
    """A closed room with a lamp, glass and steel on a table."""
    white = principled(
        "paint", Base_Color=(0.8, 0.8, 0.78, 1), Roughness=0.9, Specular_IOR_Level=0.2
    )
    red = principled("red", Base_Color=(0.6, 0.1, 0.08, 1), Roughness=0.9, Specular_IOR_Level=0.2)
    walls = [
        ((0, 0, 0), (0, 0, 0), white),
        ((0, 0, 3), (math.pi, 0, 0), white),
        ((0, 2, 1.5), (math.pi / 2, 0, 0), white),
        ((0, -4, 1.5), (-math.pi / 2, 0, 0), white),
        ((-2, 0, 1.5), (0, math.pi / 2, 0), red),
        ((2, 0, 1.5), (0, -math.pi / 2, 0), white),
    ]
    for place, turn, material in walls:
        add("plane", material, size=8, location=place, rotation=turn)
    wood = principled("wood", Base_Color=(0.4, 0.22, 0.1, 1), Roughness=0.4)
    add("cube", wood, size=1, scale=(2, 1, 0.08), location=(0, 0.6, 0.9))
    for x in (-0.9, 0.9):
        add("cube", wood, size=1, scale=(0.08, 0.9, 0.9), location=(x, 0.6, 0.45))
    clear = shader("glass", "ShaderNodeBsdfGlass", Color=(1, 1, 1, 1), Roughness=0.0, IOR=1.5)
    add(
        "uv_sphere", clear, True, radius=0.3, location=(-0.4, 0.4, 1.25), segments=64, ring_count=32
    )
    steel = principled("steel", Base_Color=(0.7, 0.7, 0.72, 1), Metallic=1, Roughness=0.3)
    add("cylinder", steel, radius=0.2, depth=0.5, location=(0.4, 0.6, 1.2), vertices=64)
    lamp("AREA", 60, location=(0, -0.5, 2.9), size=0.8)
    camera((0.3, -3.6, 1.7), 83, 28)


@scene
def fog() -> None:
    """A cube of fog without a surface, and a ball of tinted glass, on the floor of the studio."""
    studio()
    mist = bpy.data.materials.new("mist")
    mist.use_nodes = True
    mist.node_tree.nodes.remove(mist.node_tree.nodes["Principled BSDF"])
    colours = {"Color": (0.9, 0.8, 0.7, 1), "Absorption_Color": (0.1, 0.2, 0.3, 1)}
    volume(mist, "ShaderNodeVolumePrincipled", Density=1.2, Anisotropy=0.4, **colours)
    add("cube", mist, size=1.2, location=(-0.8, 0, 0.61))
    clear = shader("tinted", "ShaderNodeBsdfGlass", Color=(1, 1, 1, 1), Roughness=0.0, IOR=1.3)
    volume(clear, "ShaderNodeVolumeAbsorption", Color=(0.4, 0.7, 0.9, 1), Density=1.5)
    add(
        *("uv_sphere", clear, True), radius=0.5, location=(0.9, 0, 0.52), segments=64, ring_count=32
    )


def main(name: str, file: str) -> None:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.scene.render.resolution_x = 192
    bpy.context.scene.render.resolution_y = 128
    SCENES[name]()
    if name == "eye":
        bpy.context.scene.render.resolution_x, bpy.context.scene.render.resolution_y = 128, 192
    bpy.ops.wm.save_as_mainfile(filepath=file)


if __name__ == "__main__":
    main(*sys.argv[-2:])

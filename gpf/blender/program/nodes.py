"""Material node trees as plain values: closures with inputs.

A closure is a dictionary with its name, such as ``{"closure": "glass", "color": [1, 1, 1], …}``. An
input is a number, a list of three numbers, or one of the following:

- ``{"image": name of bpy.data.images, "channel": None, "r", "g", "b" or "a", "to_uv": 2×3 matrix,
  "extension": "REPEAT", …, "closest": whether pixels are squares, "origin": its Socket}``,
  perhaps with ``"scale"``, a factor for each channel
- ``{"attribute": name of a colour attribute}``
- ``{"bake": a Socket}``: anything else, which Cycles can turn into an image.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from mapping import read_mapping
from sockets import Input, Socket, plain

Closure = dict[str, Any]


def read_material(material: Any) -> Closure:
    """The closure of a material's surface, with that of its ``volume``, and with the Socket of its
    displacement, ``displaced``, if it has one."""
    if material is None:
        return {"closure": "diffuse", "color": [0.8, 0.8, 0.8]}
    if material.node_tree is None or not getattr(material, "use_nodes", True):
        colour = list(material.diffuse_color)[:3]
        return {"closure": "diffuse", "color": colour}
    output = material.node_tree.get_output_node("CYCLES")
    if output is None:
        return {"closure": "none"}
    found = read_closure(Input(output.inputs["Surface"]))
    if Input(output.inputs["Volume"]).origin() is not None:
        found["volume"] = read_volume(Input(output.inputs["Volume"]))
    if (displacement := Input(output.inputs["Displacement"]).origin()) is not None:
        found["displaced"] = displacement
    return found


# Blender's type of a node -> the closure, and its inputs that matter.
SHADERS = {
    "BSDF_DIFFUSE": ("diffuse", ("Color", "Roughness", "Normal")),
    "BSDF_GLOSSY": ("glossy", ("Color", "Roughness", "Anisotropy", "Normal")),
    "BSDF_METALLIC": ("metallic", ("Base Color", "Edge Tint", "Roughness", "Normal")),
    "BSDF_GLASS": ("glass", ("Color", "Roughness", "IOR", "Normal")),
    "BSDF_REFRACTION": ("refraction", ("Color", "Roughness", "IOR", "Normal")),
    "BSDF_TRANSLUCENT": ("translucent", ("Color", "Normal")),
    "BSDF_TRANSPARENT": ("transparent", ("Color",)),
    "BSDF_SHEEN": ("sheen", ("Color", "Roughness", "Normal")),
    "BSDF_TOON": ("toon", ("Color", "Normal")),
    "SUBSURFACE_SCATTERING": ("subsurface", ("Color", "Normal")),
    "EMISSION": ("emission", ("Color", "Strength")),
    "BACKGROUND": ("emission", ("Color", "Strength")),
    "BSDF_PRINCIPLED": (
        "principled",
        (
            *("Base Color", "Metallic", "Roughness", "IOR", "Alpha", "Normal"),
            *("Diffuse Roughness", "Subsurface Weight", "Specular IOR Level", "Specular Tint"),
            *("Anisotropic", "Transmission Weight", "Coat Weight", "Coat Roughness", "Coat IOR"),
            *("Sheen Weight", "Sheen Roughness", "Sheen Tint"),
            *("Emission Color", "Emission Strength"),
        ),
    ),
}


# The same for volumes.
VOLUMES = {
    "VOLUME_SCATTER": ("volume_scatter", ("Color", "Density", "Anisotropy")),
    "VOLUME_ABSORPTION": ("volume_absorption", ("Color", "Density")),
    "PRINCIPLED_VOLUME": (
        "volume_principled",
        (
            *("Color", "Density", "Anisotropy", "Absorption Color"),
            *("Emission Strength", "Blackbody Intensity"),
        ),
    ),
}


def read_volume(place: Input) -> Closure:
    """The closure of a volume. Inputs have their own value even where nodes are linked to them,
    unless these give a constant; ``varying`` are the names of the others."""
    return read_closure(place, _volume)


def read_closure(place: Input, read_shader: Callable[[Socket], Closure] | None = None) -> Closure:
    """The closure at an input; ``read_shader``: reads a single shader, by default of a surface."""
    read_shader = read_shader or _surface
    found = place.origin()
    if found is None:
        return {"closure": "none"}
    node, groups = found.node, found.groups
    if node.type == "MIX_SHADER":
        inputs = [Input(socket, groups) for socket in node.inputs]
        factor = read_value(inputs[0])
        if isinstance(factor, dict) and read_shader is _volume:
            factor = 0.5
        first, second = (read_closure(each, read_shader) for each in inputs[1:])
        return {"closure": "mix", "factor": factor, "first": first, "second": second}
    if node.type == "ADD_SHADER":
        first, second = (read_closure(Input(s, groups), read_shader) for s in node.inputs)
        return {"closure": "add", "first": first, "second": second}
    return read_shader(found)


def _surface(found: Socket) -> Closure:
    node, groups = found.node, found.groups
    if node.type in SHADERS:
        name, labels = SHADERS[node.type]
        closure: Closure = {"closure": name}
        for label in labels:
            if label in node.inputs:
                key = label.lower().replace(" ", "_")
                read = read_normal if label == "Normal" else read_value
                closure[key] = read(Input(node.inputs[label], groups))
        if closure.get("normal") is None:
            closure.pop("normal", None)
        return closure
    if "VOLUME" in node.type:  # at a surface, it does nothing
        return {"closure": "none"}
    return {"closure": "other", "node": node.bl_label, **_colour_of(node, groups)}


def _volume(found: Socket) -> Closure:
    node, groups = found.node, found.groups
    if node.type not in VOLUMES:
        return {"closure": "none", "unknown": node.bl_label}
    name, labels = VOLUMES[node.type]
    closure: Closure = {"closure": name, "varying": []}
    for label in labels:
        value = read_value(Input(node.inputs[label], groups))
        if isinstance(value, dict):
            closure["varying"].append(label.lower())
            value = plain(node.inputs[label])
        closure[label.lower().replace(" ", "_")] = value
    return closure


def _colour_of(node: Any, groups: tuple[Any, ...]) -> Closure:
    colour = node.inputs.get("Color")
    return {} if colour is None else {"color": read_value(Input(colour, groups))}


def read_value(place: Input) -> Any:
    """The value of an input that is a number or a colour."""
    found = place.origin()
    if found is None:
        return plain(place.socket)
    return read_output(found, colour=place.socket.type in ("RGBA", "VECTOR"))


def read_output(found: Socket, colour: bool) -> Any:
    """The value of an output."""
    node, groups = found.node, found.groups
    if found.socket in list(node.inputs):  # an input of a group, or of a muted node
        return _as(plain(found.socket), colour)
    if node.type in ("VALUE", "RGB"):
        return _as(plain(node.outputs[0]), colour)
    if node.type == "LIGHT_PATH":
        # As light from a lamp that a camera sees on a surface: what materials do for other rays is
        # there to save time, such as glass without caustics.
        return 1.0 if found.socket.name == "Is Camera Ray" else 0.0
    if node.type == "TEX_IMAGE":
        return _image(found) or {"bake": found}
    if node.type in ("SEPARATE_COLOR", "SEPRGB") and getattr(node, "mode", "RGB") == "RGB":
        inner = read_value(Input(node.inputs[0], groups))
        if isinstance(inner, list):
            return inner["RGB".index(found.socket.name[0])]
        if isinstance(inner, dict) and "image" in inner and inner["channel"] is None:
            at = "RGB".index(found.socket.name[0])
            scale = {"scale": [inner["scale"][at]] * 3} if "scale" in inner else {}
            return inner | {"channel": "rgb"[at], "origin": found} | scale
    if (product := _product_with_image(node, groups)) is not None:
        return product | {"origin": found}
    if node.type == "VERTEX_COLOR" or (
        node.type == "ATTRIBUTE" and node.attribute_type == "GEOMETRY"
    ):
        name = node.layer_name if node.type == "VERTEX_COLOR" else node.attribute_name
        if found.socket.name == "Color" and colour:
            return {"attribute": name, "otherwise": {"bake": found}}
    return {"bake": found}


def _product_with_image(node: Any, groups: tuple[Any, ...]) -> Closure | None:
    """The value of a node that multiplies an image by a constant, as glTF's factors are read."""
    if node.type == "MATH" and node.operation == "MULTIPLY" and not node.use_clamp:
        factors = node.inputs[:2]
    elif node.type == "MIX" and node.data_type == "RGBA" and node.blend_type == "MULTIPLY":
        whole = read_value(Input(node.inputs[0], groups)) == 1.0
        factors = [s for s in node.inputs if s.type == "RGBA"] if whole else []
        factors = [] if node.clamp_result else factors
    else:
        return None
    found = [read_value(Input(socket, groups)) for socket in factors]
    images = [value for value in found if isinstance(value, dict) and "image" in value]
    plain_ones = [_as(value, colour=True) for value in found if not isinstance(value, dict)]
    if len(images) != 1 or len(plain_ones) != 1:
        return None
    before = images[0].get("scale", [1.0, 1.0, 1.0])
    return images[0] | {"scale": [a * b for a, b in zip(before, plain_ones[0], strict=True)]}


def _as(value: Any, colour: bool) -> Any:
    if colour and not isinstance(value, list):
        return [value] * 3
    if not colour and isinstance(value, list):
        return 0.2126 * value[0] + 0.7152 * value[1] + 0.0722 * value[2]
    return value


def _image(found: Socket) -> Closure | None:
    """An image that is laid over a surface by its UVs, or None."""
    node = found.node
    image = node.image
    if image is None or image.source not in ("FILE", "GENERATED") or node.projection != "FLAT":
        return None
    to_uv = read_mapping(Input(node.inputs["Vector"], found.groups))
    if to_uv is None or node.interpolation not in ("Linear", "Closest", "Cubic", "Smart"):
        return None
    return {
        "image": image.name,
        "channel": "a" if found.socket.name == "Alpha" else None,
        "to_uv": to_uv,
        "extension": node.extension,
        "closest": node.interpolation == "Closest",
        "origin": found,
    }


def read_normal(place: Input) -> Any:
    """An image of normals with its strength, something to bake, or None."""
    found = place.origin()
    if found is None:
        return None
    node = found.node
    if node.type == "NORMAL_MAP" and node.space == "TANGENT" and node.uv_map == "":
        strength = read_value(Input(node.inputs["Strength"], found.groups))
        image = read_value(Input(node.inputs["Color"], found.groups))
        if isinstance(image, dict) and "image" in image and isinstance(strength, float):
            return image | {"strength": strength}
        if isinstance(image, list):
            return None
    return {"bake": found}


def values(closure: Closure) -> list[tuple[Closure, str]]:
    """The inputs of a closure and of those in it that are not plain: (dictionary, key)."""
    found = []
    for key, value in closure.items():
        if isinstance(value, dict) and "closure" in value:
            found += values(value) if key != "volume" else []
        elif isinstance(value, dict):
            found.append((closure, key))
    return found


def plain_inputs(closure: Closure) -> list[dict[str, Any]]:
    """The inputs that :func:`values` finds."""
    return [owner[key] for owner, key in values(closure)]


def plain_closure(closure: Closure) -> Closure:
    """A closure without Blender's own objects."""
    kept: Closure = {}
    for key, value in closure.items():
        if isinstance(value, dict):
            value = plain_closure(value)
        if key not in ("origin", "otherwise", "bake", "displaced"):
            kept[key] = value
    return kept


def with_plain_inputs(closure: Closure, other: Closure) -> Closure:
    """A closure with the plain inputs of another one that has the same nodes."""
    found = dict(closure)
    for key, value in other.items():
        if isinstance(value, dict):
            if "closure" in value and key in found:
                found[key] = with_plain_inputs(found[key], value)
        elif not isinstance(found.get(key), dict):
            found[key] = value
    return found

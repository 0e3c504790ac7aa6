"""Materials of a description (:mod:`baselines.translation.materials`) as shader nodes of Cycles."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
import numpy as np

Value = Any
Socket = Any

TANGENTS = "tangents"
"""The UVs that normal maps need: those of the mesh, turned so that v is to the left of u."""

WRAPS = {"repeat": "REPEAT", "clamp": "EXTEND", "mirror": "MIRROR"}
GRAZING = np.cos(np.radians(82))


class Shader:
    """A material's tree of nodes, while it is built."""

    def __init__(self, name: str, folder: Path, images: dict[str, Any]) -> None:
        self.folder, self.images = folder, images
        self.material = bpy.data.materials.new(name)
        self.material.use_nodes = True
        self.tree = self.material.node_tree
        self.tree.nodes.clear()
        self.normal: Socket = None

    def finish(self, shader: Socket) -> Any:
        """The material, with this shader on its surface."""
        output = self.add("ShaderNodeOutputMaterial")
        self.link(shader, output.inputs["Surface"])
        return self.material

    def add(self, kind: str, **inputs: Value) -> Any:
        """A node; spaces in the names of its inputs are written as underscores."""
        node = self.tree.nodes.new(kind)
        for name, value in inputs.items():
            self.set(node.inputs[name.replace("_", " ")], value)
        if self.normal is not None and "Normal" in node.inputs:
            self.link(self.normal, node.inputs["Normal"])
        return node

    def link(self, source: Socket, target: Socket) -> None:
        """Connect two sockets."""
        self.tree.links.new(source, target)

    def set(self, socket: Socket, value: Value) -> None:
        """Set an input to a value of a description, or to another node's output."""
        if isinstance(value, dict):
            value = self.image(value)
        if isinstance(value, bpy.types.NodeSocket):
            self.link(value, socket)
        elif socket.type == "RGBA":
            socket.default_value = (*np.broadcast_to(value, 3), 1.0)
        elif socket.type == "VECTOR":
            socket.default_value = np.broadcast_to(value, 3)
        else:
            socket.default_value = float(np.dot(np.broadcast_to(value, 3), LUMINANCE))

    def image(self, value: dict[str, Any]) -> Socket:
        """The colour of an image on the surface, or of the mesh's vertices."""
        if "attribute" in value:
            node = self.add("ShaderNodeAttribute")
            node.attribute_name = value["attribute"]
            return node.outputs["Color"]
        node = self.add("ShaderNodeTexImage")
        node.image = self.load(value["image"])
        node.extension = WRAPS[value["wrap"]]
        node.interpolation = "Closest" if value["nearest"] else "Linear"
        self.link(self.place(value["to_uv"]), node.inputs["Vector"])
        return node.outputs["Color"]

    def load(self, name: str) -> Any:
        """An image by its file."""
        if name not in self.images:
            self.images[name] = make_image(name, np.load(self.folder / name))
        return self.images[name]

    def place(self, rows: list[list[float]]) -> Socket:
        """The texture coordinates of a surface after an affine map."""
        uv = self.add("ShaderNodeTexCoord").outputs["UV"]
        if rows == [[1, 0, 0], [0, 1, 0]]:
            return uv
        joined = self.add("ShaderNodeCombineXYZ")
        for socket, (a, b, c) in zip(joined.inputs, rows, strict=False):
            dot = self.add("ShaderNodeVectorMath")
            dot.operation = "DOT_PRODUCT"
            self.link(uv, dot.inputs[0])
            dot.inputs[1].default_value = (a, b, 0)
            self.link(self.math("ADD", dot.outputs["Value"], c), socket)
        return joined.outputs[0]

    def math(self, operation: str, *values: Value) -> Socket:
        """The result of a sum, a product and the like."""
        node = self.add("ShaderNodeMath")
        node.operation = operation
        for socket, value in zip(node.inputs, values, strict=False):
            self.set(socket, value)
        return node.outputs[0]

    def mix(self, weight: Value, first: Socket, second: Socket) -> Socket:
        """``second`` by a share of ``weight``, ``first`` by the rest."""
        node = self.add("ShaderNodeMixShader")
        self.set(node.inputs[0], weight)
        self.link(first, node.inputs[1])
        self.link(second, node.inputs[2])
        return node.outputs[0]

    def backfacing(self) -> Socket:
        """1 where the surface is seen from behind, else 0."""
        return self.add("ShaderNodeNewGeometry").outputs["Backfacing"]

    def fresnel(self, ior: float) -> Socket:
        """The reflectance of a smooth surface, the same from both sides."""
        # From behind, the node itself takes the inverse.
        change = self.math("MULTIPLY", self.backfacing(), 1 / ior - ior)
        return self.add("ShaderNodeFresnel", IOR=self.math("ADD", change, ior)).outputs[0]

    def shine(self, shader: Socket, radiance: Value) -> Socket:
        """A shader that also emits light from its front."""
        front = self.math("SUBTRACT", 1.0, self.backfacing())
        light = self.add("ShaderNodeEmission", Color=radiance, Strength=front)
        both = self.add("ShaderNodeAddShader")
        self.link(shader, both.inputs[0])
        self.link(light.outputs[0], both.inputs[1])
        self.material.cycles.emission_sampling = "FRONT"
        return both.outputs[0]

    def build(self, material: dict[str, Any]) -> Socket:
        """The shader of a material."""
        return getattr(self, f"_{material['kind']}")(material)

    def _diffuse(self, material: dict[str, Any]) -> Socket:
        return self.add("ShaderNodeBsdfDiffuse", Color=material["color"]).outputs[0]

    def _translucent(self, material: dict[str, Any]) -> Socket:
        return self.add("ShaderNodeBsdfTranslucent", Color=material["color"]).outputs[0]

    def _clear(self, material: dict[str, Any]) -> Socket:
        return self.add("ShaderNodeBsdfTransparent", Color=1.0).outputs[0]

    def _glossy(self, color: Value, material: dict[str, Any]) -> Any:
        node = self.add("ShaderNodeBsdfAnisotropic", Color=color)
        self._roughen(node, material)
        return node.outputs[0]

    def _roughen(self, node: Any, material: dict[str, Any]) -> None:
        """Roughness and anisotropy: α = r² √(1 - a)±¹ by Blender's rules."""
        # Without light that bounces between facets, as in Mitsuba.
        node.distribution = "GGX" if material["distribution"] == "ggx" else "BECKMANN"
        u, v = material["alpha"]
        if isinstance(u, dict) or isinstance(v, dict):
            self.set(node.inputs["Roughness"], self.math("SQRT", u))
            return
        self.set(node.inputs["Roughness"], (u * v) ** 0.25)
        if u != v and "Anisotropy" in node.inputs:
            turned = 1 - (v / u) ** 0.5 if u > v else (u / v) ** 0.5 - 1
            self.set(node.inputs["Anisotropy"], float(np.clip(turned, -0.99, 0.99)))
            tangent = self.add("ShaderNodeTangent")
            tangent.direction_type = "UV_MAP"
            self.link(tangent.outputs[0], node.inputs["Tangent"])

    def _conductor(self, material: dict[str, Any]) -> Socket:
        if material["eta"] is None:
            return self._glossy(material["tint"], material)
        node = self.add("ShaderNodeBsdfMetallic")
        self._roughen(node, material)
        eta, k = (np.broadcast_to(material[key], 3) for key in ("eta", "k"))
        if material["tint"] == 1 or material["tint"] == [1.0, 1.0, 1.0]:
            node.fresnel_type = "PHYSICAL_CONDUCTOR"
            self.set(node.inputs["IOR"], eta)
            self.set(node.inputs["Extinction"], k)
            return node.outputs[0]
        # With a tint, the reflectance is right along the normal and at 82 degrees.
        node.fresnel_type = "F82"
        ahead, grazing = reflectance(eta, k, 1.0), reflectance(eta, k, GRAZING)
        tint = self._pixels(material["tint"])
        base = np.clip(ahead * tint, 0, 1)
        schlick = base + (1 - base) * (1 - GRAZING) ** 5
        edge = np.clip(grazing * tint / np.maximum(schlick, 1e-6), 0, 1)
        for name, found in (("Base Color", base), ("Edge Tint", edge)):
            self.set(node.inputs[name], self._changed(material["tint"], found, name))
        return node.outputs[0]

    def _pixels(self, value: Value) -> np.ndarray:
        if isinstance(value, dict):
            return np.load(self.folder / value["image"])
        return np.broadcast_to(value, 3)

    def _changed(self, value: Value, found: np.ndarray, name: str) -> Value:
        """An image with other pixels in the same place, or a plain colour."""
        if not isinstance(value, dict):
            return found
        name = f"{self.material.name} {name}"
        self.images[name] = make_image(name, found)
        return value | {"image": name}

    def _dielectric(self, material: dict[str, Any]) -> Socket:
        ior, back, through = (material[key] for key in ("ior", "reflectance", "transmittance"))
        if back == through:
            node = self.add("ShaderNodeBsdfGlass", Color=back, IOR=ior)
            self._roughen(node, material)
            return node.outputs[0]
        node = self.add("ShaderNodeBsdfRefraction", Color=through, IOR=ior)
        self._roughen(node, material)
        share = self.add("ShaderNodeFresnel", IOR=ior).outputs[0]
        return self.mix(share, node.outputs[0], self._glossy(back, material))

    def _thin(self, material: dict[str, Any]) -> Socket:
        once = self.fresnel(material["ior"])
        # R + T² R + T² R³ ... = 2 R / (1 + R)
        whole = self.math("DIVIDE", self.math("MULTIPLY", once, 2.0), self.math("ADD", once, 1.0))
        through = self.add("ShaderNodeBsdfTransparent", Color=material["transmittance"])
        smooth = {"alpha": [0.0, 0.0], "distribution": "ggx"}
        return self.mix(whole, through.outputs[0], self._glossy(material["reflectance"], smooth))

    def _plastic(self, material: dict[str, Any]) -> Socket:
        base = self.add("ShaderNodeBsdfDiffuse", Color=material["color"]).outputs[0]
        coat = self._glossy(material["specular"], material)
        return self.mix(self.fresnel(material["ior"]), base, coat)

    def _principled(self, material: dict[str, Any]) -> Socket:
        get = material.get
        node = self.add(
            "ShaderNodeBsdfPrincipled",
            Base_Color=get("base_color"),
            Metallic=get("metallic"),
            Roughness=get("roughness"),
            IOR=get("ior"),
            Anisotropic=get("anisotropic"),
            Transmission_Weight=get("spec_trans"),
            Sheen_Weight=get("sheen"),
        )
        node.distribution = "GGX"
        # Mitsuba's coat has a quarter of the strength, and an α of 0.1 to 0.001.
        self.set(node.inputs["Coat Weight"], self.math("MULTIPLY", get("clearcoat"), 0.25))
        alpha = self.math("ADD", self.math("MULTIPLY", get("clearcoat_gloss"), -0.099), 0.1)
        self.set(node.inputs["Coat Roughness"], self.math("SQRT", alpha))
        return node.outputs[0]

    def _mix(self, material: dict[str, Any]) -> Socket:
        first, second = self.build(material["first"]), self.build(material["second"])
        return self.mix(material["weight"], first, second)

    def _sides(self, material: dict[str, Any]) -> Socket:
        front, back = self.build(material["front"]), self.build(material["back"])
        return self.mix(self.backfacing(), front, back)

    def _bump(self, material: dict[str, Any]) -> Socket:
        node = self.add("ShaderNodeBump", Height=material["height"], Distance=material["scale"])
        node.inputs["Strength"].default_value = 1.0
        return self._bent(node, material["inside"])

    def _normals(self, material: dict[str, Any]) -> Socket:
        node = self.add("ShaderNodeNormalMap", Color=material["map"])
        node.uv_map = TANGENTS
        return self._bent(node, material["inside"])

    def _bent(self, node: Any, inside: dict[str, Any]) -> Socket:
        before, self.normal = self.normal, node.outputs["Normal"]
        found = self.build(inside)
        self.normal = before
        return found


LUMINANCE = (0.2126, 0.7152, 0.0722)


def make_image(name: str, pixels: np.ndarray) -> Any:
    """An image of linear values, (H, W, C); its first row is at the bottom, where v is 0."""
    height, width, channels = pixels.shape
    whole = np.ones((height, width, 4), np.float32)
    whole[..., :3] = pixels[..., : 3 if channels >= 3 else 1]
    made = bpy.data.images.new(name, width, height, float_buffer=True, is_data=True)
    made.pixels.foreach_set(whole.ravel())
    made.pack()
    return made


def reflectance(eta: np.ndarray, k: np.ndarray, cosine: float) -> np.ndarray:
    """The reflectance of a conductor."""
    sine2 = 1 - cosine**2
    inner = eta**2 - k**2 - sine2
    both = np.sqrt(inner**2 + (2 * eta * k) ** 2)
    a = np.sqrt(np.maximum((both + inner) / 2, 0))
    across = (both - 2 * a * cosine + cosine**2) / (both + 2 * a * cosine + cosine**2)
    slope = 2 * a * cosine * sine2
    near = cosine**2 * both + sine2**2
    return across * (1 + (near - slope) / (near + slope)) / 2

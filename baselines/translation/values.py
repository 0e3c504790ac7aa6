"""Parameters of a plugin as numbers, colours and images.

A value in a description is one of these:

- a number, or a colour ``[r, g, b]``, linear;
- an image ``{"image": file, "to_uv": [[a, b, c], [d, e, f]], "wrap": ..., "nearest": ...}``, linear
  float32, (H, W, 3). Row 0 is at v = 0, column 0 at u = 0. ``to_uv`` maps the texture coordinates
  of a surface to those of the image; ``wrap`` is "repeat", "clamp" or "mirror";
- ``{"attribute": "color"}``: colours at the vertices of a mesh.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from baselines.protocol import CannotServe
from baselines.translation.nodes import Node

Value = Any


NUMBERS = {
    *("alpha", "alpha_u", "alpha_v", "opacity", "weight", "roughness", "metallic", "anisotropic"),
    *("spec_trans", "spec_tint", "sheen", "sheen_tint", "flatness", "clearcoat", "clearcoat_gloss"),
}
"""Parameters of which Mitsuba takes one channel."""


class Values:
    """Reads values and writes images into a folder."""

    def __init__(self, folder: Path, where: str) -> None:
        self.folder, self.where = folder, where
        self._written: dict[tuple[int, bool], Value] = {}
        self._count = 0

    def of(self, node: Node) -> Parameters:
        """The parameters of a BSDF or texture."""
        return Parameters(self, node)

    def radiance(self, node: Node, key: str, otherwise: float = 1.0) -> Value:
        """A parameter of an emitter."""
        if key in node.parts and is_image(node.parts[key]):
            return self.image(node.parts[key])
        given = node.parts[key].as_dict() if key in node.parts else node.values.get(key, otherwise)
        # Spectra in emitters have other units, so an emitter must be loaded.
        probe = mi.load_dict({"type": "point", "intensity": given})
        return plain(mi.traverse(probe)["intensity.value"])

    def image(self, node: Node, number: bool = False) -> Value:
        """A texture, as a colour or as a number.

        Raises
        ------
        CannotServe: it is neither a bitmap nor a checkerboard nor colours at vertices.
        """
        key = id(node), number
        if key not in self._written:
            self._written[key] = self._make_image(node, number)
        return self._written[key]

    def _make_image(self, node: Node, number: bool) -> Value:
        if node.plugin == "mesh_attribute" and node.values.get("name") == "vertex_color":
            return {"attribute": "color"}
        if node.plugin == "bitmap":
            pixels = _texels(node)
            nearest = node.values.get("filter_type", "bilinear") == "nearest"
            return self._write(pixels, node, node.values.get("wrap_mode", "repeat"), nearest)
        if node.plugin == "checkerboard":
            parameters = self.of(node)
            colours = [parameters(name, grey) for name, grey in (("color0", 0.4), ("color1", 0.2))]
            if any(isinstance(colour, dict) for colour in colours):
                raise self.refuse("a checkerboard of images is not translated")
            a, b = (np.broadcast_to(colour, 3) for colour in colours)
            if number:  # then Mitsuba has them the other way round
                a, b = b, a
            return self._write(np.array([[a, b], [b, a]]), node, "repeat", nearest=True)
        raise self.refuse(f"textures of type {node.plugin} are not translated")

    def _write(self, pixels: np.ndarray, node: Node, wrap: str, nearest: bool) -> Value:
        """Write an image, and the place on the surface that its node says."""
        name = self.save(pixels)
        matrix = np.eye(3)
        if "to_uv" in node.values:
            given = np.array(node.values["to_uv"].matrix, dtype=float)
            # Transforms of scene files have three dimensions, of which the last is left out.
            matrix = given if given.shape == (3, 3) else given[np.ix_([0, 1, 3], [0, 1, 3])]
        place: dict[str, Any] = {"to_uv": matrix[:2].tolist()}
        return {"image": name, **place, "wrap": wrap, "nearest": nearest}

    def changed(self, value: Value, change: Callable[[np.ndarray], np.ndarray]) -> Value:
        """A value after a function of each channel; colours at vertices stay as they are."""
        if not isinstance(value, dict):
            return plain(change(np.asarray(value, dtype=float)))
        if "attribute" in value:
            return value
        pixels = change(np.load(self.folder / value["image"]))
        return value | {"image": self.save(pixels)}

    def save(self, pixels: np.ndarray) -> str:
        """Write pixels, (H, W, C); the name of their file."""
        self._count += 1
        name = f"image_{self._count}.npy"
        np.save(self.folder / name, pixels.astype(np.float32))
        return name

    def refuse(self, what: str) -> CannotServe:
        """The error for what is not translated."""
        return CannotServe(self.where, what, "Leave the system out for this scene.")


class Parameters:
    """Reads the parameters of one plugin."""

    def __init__(self, values: Values, node: Node) -> None:
        self.values, self.node = values, node
        # Mitsuba itself knows the optical constants of materials.
        bare = node.as_dict(mi.ObjectType.BSDF, mi.ObjectType.Texture)
        self._known = {} if node.of_kind(mi.ObjectType.BSDF) else _traverse(bare)

    def __call__(self, key: str, otherwise: float) -> Value:
        """A parameter, or what Mitsuba takes ``otherwise``."""
        part = self.node.parts.get(key)
        if part is not None and is_image(part):
            return self.values.image(part, number=key in NUMBERS)
        if part is not None:
            return plain(
                _traverse({"type": "diffuse", "reflectance": part.as_dict()})["reflectance.value"]
            )
        given = self.node.values.get(key)
        if isinstance(given, (int, float)):
            return float(given)
        for name in (f"{key}.value", key):
            if given is not None and name in self._known:
                return plain(self._known[name])
        if given is not None:
            return plain(_traverse({"type": "diffuse", "reflectance": given})["reflectance.value"])
        return otherwise

    def known(self, key: str) -> Value:
        """A number or colour that the loaded plugin has, such as ``eta``."""
        return plain(self._known[key])


def _texels(node: Node) -> np.ndarray:
    """The linear values of a bitmap, (H, W, 3)."""
    bare = {key: value for key, value in node.values.items() if key != "to_uv"}
    texture = mi.load_dict({"type": "bitmap", **bare, "filter_type": "nearest"})
    width, height = (int(n) for n in texture.resolution())
    index = dr.arange(mi.UInt32, width * height)
    si = dr.zeros(mi.SurfaceInteraction3f, width * height)
    si.uv = (mi.Point2f(index % width, index // width) + 0.5) / mi.Point2f(width, height)
    colours = np.array(texture.eval(si), dtype=np.float32)
    return colours.T.reshape(height, width, 3)


def is_image(node: Node) -> bool:
    """Whether a texture varies over a surface, or is of a type that nobody knows."""
    known = {"rgb", "srgb", "uniform", "spectrum", "regular", "irregular", "blackbody", "d65"}
    return node.plugin not in known


def plain(value: Any) -> Value:
    """A number or ``[r, g, b]``."""
    found = np.ravel(np.asarray(value, dtype=float))
    return float(found[0]) if found.size == 1 else [float(x) for x in found]


def _traverse(scene: dict[str, Any]) -> Any:
    return mi.traverse(mi.load_dict(scene))

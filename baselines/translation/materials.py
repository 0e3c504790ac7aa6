"""Materials in plain words.

Each is an object with a ``kind``; values are those of :mod:`baselines.translation.values`.

===========  ===================================================================================
kind         other keys
===========  ===================================================================================
diffuse      ``color``
translucent  ``color``: diffuse, on the other side
conductor    ``eta``, ``k`` (None: a perfect mirror), ``tint``
dielectric   ``ior`` (inside by outside), ``reflectance``, ``transmittance``: factors
thin         the same, for a pane with all reflections within
plastic      ``ior``, ``color``, ``specular`` (factor)
principled   the parameters of Mitsuba's plugin
clear        light passes as through nothing
mix          ``weight`` of ``second``; ``first``, ``second``
sides        ``front``, ``back``
bump         ``height``, times ``scale`` in world units, of what is ``inside``
normals      ``map`` of normals in the frame of the texture, 0.5 for 0, of what is ``inside``
===========  ===================================================================================

Conductors, dielectrics and plastics have ``alpha`` [u, v], 0 if smooth, and ``distribution``.
``color`` of plastic is what the diffuse base sends out per light that a smooth coat lets through.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mitsuba as mi
import numpy as np

from baselines.translation.nodes import Node
from baselines.translation.values import Value, Values
from gpf.blender.energy import layer_factor, share_under_sky
from gpf.scene.materials import diffuse_context

Material = dict[str, Any]

BLACK: Material = {"kind": "diffuse", "color": 0.0}
GREY: Material = {"kind": "diffuse", "color": 0.5}
CLEAR: Material = {"kind": "clear"}

ONE_SIDED = ("diffuse", "conductor", "roughconductor", "plastic", "roughplastic")
"""Plugins that are black from behind."""


def translate(node: Node, values: Values) -> Material:
    """The material of a BSDF.

    Raises
    ------
    CannotServe: it, or one that it contains, is not translated.
    """
    if node.plugin not in _MAKERS:
        raise values.refuse(f"materials of type {node.plugin} are not translated")
    found = _MAKERS[node.plugin](node, values)
    return _one_sided(found) if node.plugin in ONE_SIDED else found


def _one_sided(front: Material) -> Material:
    return {"kind": "sides", "front": front, "back": BLACK}


def _inner(node: Node, values: Values) -> list[Material]:
    """The materials that a BSDF contains."""
    return [translate(part, values) for part in node.of_kind(mi.ObjectType.BSDF)]


def _diffuse(node: Node, values: Values) -> Material:
    return {"kind": "diffuse", "color": values.of(node)("reflectance", 0.5)}


def _conductor(node: Node, values: Values) -> Material:
    parameters = values.of(node)
    given = {"eta", "k"} & {*node.values, *node.parts}
    perfect = not given and node.values.get("material", "none") == "none"
    constants: dict[str, Value] = {"eta": None, "k": None}
    if not perfect:
        if {"eta", "k"} & node.parts.keys():
            raise values.refuse("textured optical constants are not translated")
        constants = {key: parameters.known(f"{key}.value") for key in ("eta", "k")}
        outside = parameters("ext_eta", 1.0)
        constants = {k: (np.array(v) / outside).tolist() for k, v in constants.items()}
    tint = parameters("specular_reflectance", 1.0)
    return {"kind": "conductor", **constants, "tint": tint} | _roughness(node, values)


def _roughness(node: Node, values: Values) -> Material:
    """``alpha`` along u and v, and the distribution; smooth plugins have an alpha of 0."""
    if not node.plugin.startswith("rough"):
        return {"alpha": [0.0, 0.0], "distribution": "ggx"}
    parameters = values.of(node)
    alpha = parameters("alpha", 0.1)
    return {
        "alpha": [parameters(f"alpha_{axis}", alpha) for axis in "uv"],
        "distribution": node.values.get("distribution", "beckmann"),
    }


def _dielectric(node: Node, values: Values) -> Material:
    parameters = values.of(node)
    names = ("reflectance", "transmittance")
    tints = {name: parameters(f"specular_{name}", 1.0) for name in names}
    found = {"kind": "dielectric", "ior": parameters.known("eta"), **tints}
    if node.plugin == "thindielectric":
        return found | {"kind": "thin"}
    return found | _roughness(node, values)


def _plastic(node: Node, values: Values) -> Material:
    parameters = values.of(node)
    ior = parameters.known("eta")
    # Mitsuba's diffuse part reflects g ρ / (1 - f ρ); g and f from two albedos.
    half, whole = (_diffuse_share(node, rho) for rho in (0.5, 1.0))
    f = (whole - 2 * half) / (whole - half)
    g = whole * (1 - f) / (1 - mean_fresnel(ior))
    colour = values.changed(
        parameters("diffuse_reflectance", 0.5), lambda rho: g * rho / (1 - f * rho)
    )
    found = {"kind": "plastic", "ior": ior, "color": colour}
    found["specular"] = parameters("specular_reflectance", 1.0)
    return found | _roughness(node, values)


def _diffuse_share(node: Node, reflectance: float, count: int = 1 << 18) -> float:
    """The share of light under a uniform sky that the diffuse part of a plastic reflects."""
    grey = {"type": "rgb", "value": [reflectance] * 3}
    bare = node.as_dict(mi.ObjectType.Texture) | {"diffuse_reflectance": grey}
    return share_under_sky(bare, diffuse_context(), count)


def mean_fresnel(eta: float, steps: int = 4000) -> float:
    """The share of light under a uniform sky that a smooth surface reflects."""
    # Their squares in equal steps, cosines have the weights of such a sky.
    cosine = np.sqrt((np.arange(steps) + 0.5) / steps)
    beyond = np.sqrt(1 - (1 - cosine**2) / eta**2)
    parallel = (eta * cosine - beyond) / (eta * cosine + beyond)
    across = (cosine - eta * beyond) / (cosine + eta * beyond)
    return float((parallel**2 + across**2).mean() / 2)


PRINCIPLED = {
    "base_color": 0.5,
    "roughness": 0.5,
    "anisotropic": 0.0,
    "metallic": 0.0,
    "spec_trans": 0.0,
    "spec_tint": 0.0,
    "sheen": 0.0,
    "sheen_tint": 0.0,
    "flatness": 0.0,
    "clearcoat": 0.0,
    "clearcoat_gloss": 0.0,
}
"""The parameters of Mitsuba's `principled`, with what they are if nothing is given."""


def _principled(node: Node, values: Values) -> Material:
    parameters = values.of(node)
    found: Material = {"kind": "principled", "ior": _principled_ior(node)}
    found |= {key: parameters(key, otherwise) for key, otherwise in PRINCIPLED.items()}
    rough = found["roughness"]
    if found["metallic"] == found["spec_trans"] == 0 and not isinstance(rough, dict):
        level = min(((found["ior"] - 1) / (found["ior"] + 1)) ** 2 / 0.08, 1.0)
        factor = layer_factor(rough, level)
        found["base_color"] = values.changed(
            found["base_color"], lambda c: np.minimum(c / factor, 1)
        )
    return found if found["spec_trans"] != 0 else _one_sided(found)


def _principled_ior(node: Node) -> float:
    if "eta" in node.values:
        return float(node.values["eta"])
    level = float(node.values.get("specular", 0.5))
    return float(2 / (1 - np.sqrt(0.08 * level)) - 1)


def _principled_thin(node: Node, values: Values) -> Material:
    """Diffuse on both sides. Its reflection, which has no name elsewhere, is left out."""
    parameters = values.of(node)
    through = parameters("diff_trans", 0.0)
    if parameters("spec_trans", 0.0) != 0 or isinstance(through, dict):
        raise values.refuse("principledthin with spec_trans or textured diff_trans")
    colour = parameters("base_color", 0.5)
    sides = [{"kind": kind, "color": colour} for kind in ("diffuse", "translucent")]
    return {"kind": "mix", "weight": through / 2, "first": sides[0], "second": sides[1]}


def _two_sided(node: Node, values: Values) -> Material:
    sides = _inner(node, values)
    front, back = (
        side["front"] if side["kind"] == "sides" else side for side in (sides[0], sides[-1])
    )
    return front if front == back else {"kind": "sides", "front": front, "back": back}


def _mask(node: Node, values: Values) -> Material:
    opacity = values.of(node)("opacity", 0.5)
    (inside,) = _inner(node, values)
    return {"kind": "mix", "weight": opacity, "first": CLEAR, "second": inside}


def _blend(node: Node, values: Values) -> Material:
    first, second = _inner(node, values)
    weight = values.of(node)("weight", 0.5)
    return {"kind": "mix", "weight": weight, "first": first, "second": second}


def _bump(node: Node, values: Values) -> Material:
    (inside,) = _inner(node, values)
    (texture,) = node.of_kind(mi.ObjectType.Texture)
    height = values.image(texture)
    return _within(
        inside, {"kind": "bump", "height": height, "scale": node.values.get("scale", 1.0)}
    )


def _normals(node: Node, values: Values) -> Material:
    (inside,) = _inner(node, values)
    (texture,) = node.of_kind(mi.ObjectType.Texture)
    return _within(inside, {"kind": "normals", "map": values.image(texture)})


def _within(inside: Material, changed: Material) -> Material:
    """A material with changed normals; those of what is one-sided change on its front alone."""
    if inside["kind"] == "sides":
        return inside | {"front": changed | {"inside": inside["front"]}}
    return changed | {"inside": inside}


def _clear(node: Node, values: Values) -> Material:
    return CLEAR


_MAKERS: dict[str, Callable[[Node, Values], Material]] = {
    "diffuse": _diffuse,
    "conductor": _conductor,
    "roughconductor": _conductor,
    "dielectric": _dielectric,
    "roughdielectric": _dielectric,
    "thindielectric": _dielectric,
    "plastic": _plastic,
    "roughplastic": _plastic,
    "principled": _principled,
    "principledthin": _principled_thin,
    "twosided": _two_sided,
    "mask": _mask,
    "blendbsdf": _blend,
    "bumpmap": _bump,
    "normalmap": _normals,
    "null": _clear,
}

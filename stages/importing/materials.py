"""The materials of an imported scene, and how photon mapping treats each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import mitsuba as mi

from gpf.scene.inventory import scene_materials
from stages.common.inventory import scene_info

Use = Literal["queried", "traced through", "both", "unsupported"]

PLUGINS = {
    "AreaLight": "area",
    "BlendBSDF": "blendbsdf",
    "BumpMap": "bumpmap",
    "CircularPolarizer": "circular",
    "ConstantBackgroundEmitter": "constant",
    "DirectionalArea": "directionalarea",
    "DirectionalEmitter": "directional",
    "EnvironmentMapEmitter": "envmap",
    "Hair": "hair",
    "LinearPolarizer": "polarizer",
    "LinearRetarder": "retarder",
    "MaskBSDF": "mask",
    "Measured": "measured",
    "MeasuredPolarized": "measured_polarized",
    "NormalMap": "normalmap",
    "Null": "null",
    "PointLight": "point",
    "PolarizedPlastic": "pplastic",
    "Projector": "projector",
    "RoughConductor": "roughconductor",
    "RoughDielectric": "roughdielectric",
    "RoughPlastic": "roughplastic",
    "SmoothConductor": "conductor",
    "SmoothDielectric": "dielectric",
    "SmoothDiffuse": "diffuse",
    "SmoothPlastic": "plastic",
    "SpotLight": "spot",
    "SunskyEmitter": "sunsky",
    "ThinDielectric": "thindielectric",
    "TwoSidedBRDF": "twosided",
}
"""Mitsuba's class names -> plugin names, as in scene files."""


@dataclass(frozen=True)
class Material:
    """A material in use.

    Attributes
    ----------
    name: its id, or a name made from its shape's id.
    kind: its plugins, outermost first.
    use: ``queried``: photons are stored and camera rays end there; ``traced through``: paths go on;
        ``both``: one of the two, at random; ``unsupported``: paths end and nothing is stored.
    """

    name: str
    kind: str
    use: Use


def list_materials(scene: mi.Scene) -> tuple[Material, ...]:
    """The materials in use, each with how photon mapping treats it."""
    uses: dict[tuple[bool, bool], Use] = {
        (True, False): "queried",
        (False, True): "traced through",
        (True, True): "both",
        (False, False): "unsupported",
    }
    info = scene_info(scene)["bsdfs"]
    return tuple(
        Material(name, kind_of(bsdf), uses[info[name]["queried"], info[name]["traced"]])
        for name, bsdf in scene_materials(scene).items()
    )


def kind_of(bsdf: mi.BSDF) -> str:
    """The plugins of a material, outermost first: ``twosided diffuse``."""
    nested = [o for o in mi.traverse(bsdf).hierarchy if isinstance(o, mi.BSDF)]
    return " ".join(dict.fromkeys(PLUGINS.get(o.class_name(), o.class_name()) for o in nested))

"""Materials and lamps as numbers per triangle, for renderers of coloured triangles.

A material becomes a diffuse colour, a white specular reflectance at normal incidence, and a
roughness (the square root of a microfacet distribution's α). This is exact for diffuse surfaces.
For plastic it ignores the internal reflection of the coating, and for metals the colour, because
such a renderer was trained with white reflections only. Materials that have transmission or
textures, or are of other types, are refused: the result would be a different scene.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mitsuba as mi
import numpy as np

from baselines.protocol import CannotServe
from gpf.scene.inventory import scene_materials

# Roughness of perfectly smooth surfaces and of diffuse surfaces: the ends of the range.
SMOOTHEST, ROUGHEST = 0.01, 0.99


@dataclass(frozen=True)
class Material:
    """``diffuse`` (3,) and ``specular`` (3,): reflectances; ``roughness``: 0.01 to 0.99."""

    diffuse: np.ndarray
    specular: np.ndarray
    roughness: float


def refuse_what_triangles_lack(scene: mi.Scene, where: str) -> None:
    """Raise :class:`CannotServe` for transmission, textures, and lights other than area lights.

    Transmission is checked first, because small changes of the scene cannot remove it.
    """
    materials = scene_materials(scene)
    for name, bsdf in materials.items():
        flags = bsdf.flags()
        if mi.has_flag(flags, mi.BSDFFlags.Transmission) or mi.has_flag(flags, mi.BSDFFlags.Null):
            raise CannotServe(
                f"{where}: {name}",
                "no transmission",
                "The system has no glass, water or cut-outs: leave it out for this scene.",
            )
    # Not mi.traverse(scene): its hierarchy has textures that no surface uses.
    for name, owner in [*materials.items(), *_name_emitters(scene)]:
        if any(isinstance(o, mi.Texture) and not _is_constant(o) for o in _parts(owner)):
            raise CannotServe(
                f"{where}: {name}",
                "no textures",
                "The system has one colour per triangle: leave it out for this scene.",
            )
    for _, emitter in _name_emitters(scene):
        if emitter.class_name() != "AreaLight":
            raise CannotServe(
                where,
                f"has a light of type {emitter.class_name()}; only glowing triangles are supported",
                "Light the scene with area emitters on shapes, or leave the system out for it.",
            )


def read_material(bsdf: mi.BSDF, where: str) -> Material:
    """The numbers of a BSDF that :func:`refuse_what_triangles_lack` accepts.

    Raises
    ------
    CannotServe: it is not diffuse, plastic or metal, or its two sides differ.
    """
    values = mi.traverse(bsdf)
    kind = bsdf.class_name()
    if kind == "TwoSidedBRDF":
        inner = [part for part in _parts(bsdf) if isinstance(part, mi.BSDF) and part is not bsdf]
        if len({id(part) for part in inner}) == 1:
            return read_material(inner[0], where)
        kind = f"{kind} with two different sides"
    if kind == "SmoothDiffuse":
        return Material(_colour(values, "reflectance"), np.zeros(3), ROUGHEST)
    if kind in ("SmoothPlastic", "RoughPlastic"):
        eta = float(np.ravel(np.asarray(values["eta"]))[0])
        specular = ((eta - 1) / (eta + 1)) ** 2 * _tint(values)
        diffuse = _colour(values, "diffuse_reflectance")
        return Material(np.minimum(diffuse, 1 - specular), _whiten(specular), _roughness(values))
    if kind in ("SmoothConductor", "RoughConductor"):
        n, k = _colour(values, "eta"), _colour(values, "k")
        fresnel = ((n - 1) ** 2 + k**2) / ((n + 1) ** 2 + k**2)
        specular = fresnel * _tint(values)
        return Material(np.zeros(3), _whiten(specular), _roughness(values))
    raise CannotServe(
        f"{where}: {bsdf.id()}",
        f"materials of type {kind} are not supported",
        "The system has diffuse surfaces, plastic and metals: leave it out for this scene.",
    )


def read_radiance(emitter: mi.Emitter) -> np.ndarray:
    """The radiance of an area light, W/(m² sr), (3,)."""
    return _colour(mi.traverse(emitter), "radiance")


def _colour(values: Any, name: str) -> np.ndarray:
    """A spectrum of ``mi.traverse`` as three numbers."""
    return np.broadcast_to(np.ravel(np.asarray(values[f"{name}.value"], dtype=float)), 3).copy()


def _tint(values: Any) -> np.ndarray:
    """The factor for the specular reflection; 1 if the scene does not set it."""
    known = "specular_reflectance.value" in values
    return _colour(values, "specular_reflectance") if known else np.ones(3)


def _whiten(colour: np.ndarray) -> np.ndarray:
    return np.full(3, colour.mean())


def _roughness(values: Any) -> float:
    """√α, with the mean α where there are two; SMOOTHEST without α."""
    names = [f"{name}{end}" for name in ("alpha", "alpha_u", "alpha_v") for end in ("", ".value")]
    found = [np.ravel(np.asarray(values[name]))[0] for name in names if name in values]
    if not found:
        return SMOOTHEST
    return float(np.clip(np.sqrt(np.mean(found)), SMOOTHEST, ROUGHEST))


def _is_constant(texture: mi.Texture) -> bool:
    # Not is_spatially_varying, which is False for mesh attributes.
    return texture.class_name().endswith("Spectrum")


def _name_emitters(scene: mi.Scene) -> list[tuple[str, mi.Emitter]]:
    return [(emitter.id() or emitter.class_name(), emitter) for emitter in scene.emitters()]


def _parts(thing: mi.Object) -> list[mi.Object]:
    """An object and all objects that it contains."""
    return [part for part in mi.traverse(thing).hierarchy if isinstance(part, mi.Object)]

"""Blender's Principled BSDF as the BSDF of Mitsuba that comes closest."""

from __future__ import annotations

from typing import Any

from gpf.blender.closures import (
    SMOOTH,
    Closure,
    Dict,
    Material,
    Texture,
    is_number,
    make_glass,
    make_metal,
    radiance,
    scaled,
)
from gpf.blender.energy import layer_factor, layer_share

DULL = 0.75
"""Roughness from which the reflection of a dielectric layer is as good as diffuse."""


def make_principled(closure: Closure, texture: Texture) -> Material:
    """Glass, plastic, a diffuse surface, metal or `principled`, by the parts that count."""
    notes: list[str] = []
    get = closure.get
    colour, roughness = closure["base_color"], closure["roughness"]
    metallic, through = get("metallic", 0.0), get("transmission_weight", 0.0)
    ior = get("ior", 1.5) if is_number(get("ior", 1.5)) else 1.5
    if get("subsurface_weight", 0.0) != 0:
        notes.append("subsurface scattering as a diffuse surface")
    if get("diffuse_roughness", 0.0) != 0:
        notes.append("rough diffuse surface as a smooth one")
    if through == 1 and metallic == 0:
        tint = [c**0.5 for c in colour] if isinstance(colour, list) else colour
        clear = {"closure": "principled", "color": tint, "roughness": roughness, "ior": ior}
        found = make_glass(clear, texture)
    elif through == 0 and metallic == 0 and _is_smooth(closure):
        found = _plastic(closure, texture, ior)
    elif through == 0 and metallic == 0 and _is_dull(closure):
        found = _dull(closure, texture, ior, notes)
    elif through == 0 and metallic == 1:
        found = make_metal(closure, texture)
    else:
        found = _disney(closure, texture, ior, notes)
    notes += [note for note in found.notes if note not in notes]
    found.notes = notes
    strength = get("emission_strength", 0.0)
    found.emission = radiance(get("emission_color", [1, 1, 1]), strength, texture, notes)
    if get("alpha", 1.0) != 1:
        found.opacity = texture(closure["alpha"], "value")
    return found


def _is_smooth(closure: Closure) -> bool:
    """Whether there is a smooth layer and nothing above it, or no layer at all."""
    smooth = is_number(closure["roughness"]) and closure["roughness"] < SMOOTH
    return not _has_coat(closure) and (smooth or closure.get("specular_ior_level", 0.5) == 0)


def _has_coat(closure: Closure) -> bool:
    return closure.get("coat_weight", 0.0) != 0 or closure.get("sheen_weight", 0.0) != 0


def _is_dull(closure: Closure) -> bool:
    roughness = closure["roughness"]
    return not _has_coat(closure) and is_number(roughness) and roughness >= DULL


def _dull(closure: Closure, texture: Texture, ior: float, notes: list[str]) -> Material:
    """A diffuse surface that reflects as much as one below a rough layer, a + c (1 - a)."""
    f0 = _reflectance(ior, closure.get("specular_ior_level", 0.5), notes)
    a = layer_share(closure["roughness"], min(f0 / 0.08, 1.0))
    colour = closure["base_color"]
    if isinstance(colour, list):
        colour = [a + c * (1 - a) for c in colour]
    elif "attribute" not in colour:
        colour = scaled(colour, 1 - a) | {"offset": a}
    return Material({"type": "diffuse", "reflectance": texture(colour, "color")})


def _plastic(closure: Closure, texture: Texture, ior: float) -> Material:
    """A diffuse base below a smooth dielectric layer."""
    notes: list[str] = []
    f0 = _reflectance(ior, closure.get("specular_ior_level", 0.5), notes)
    base = texture(closure["base_color"], "color")
    if f0 < 1e-4:
        return Material({"type": "diffuse", "reflectance": base}, notes=notes)
    eta = (1 + f0**0.5) / (1 - f0**0.5)
    bsdf = {"diffuse_reflectance": base, "int_ior": eta, "ext_ior": 1.0, "nonlinear": False}
    return Material({"type": "plastic"} | bsdf, notes=notes)


def _reflectance(ior: float, level: Any, notes: list[str]) -> float:
    """F₀ of a dielectric whose reflection is scaled by twice ``level``."""
    if not is_number(level):
        notes.append("textured specular level as 0.5")
        level = 0.5
    return float(min(((ior - 1) / (ior + 1)) ** 2 * 2 * level, 0.99))


def _disney(closure: Closure, texture: Texture, ior: float, notes: list[str]) -> Material:
    """Mitsuba's `principled`, which takes textures for most of its parameters."""
    get = closure.get
    bsdf: Dict = {
        "type": "principled",
        "base_color": texture(closure["base_color"], "color"),
        "roughness": texture(closure["roughness"], "value"),
        "metallic": texture(get("metallic", 0.0), "value"),
    }
    f0 = _reflectance(ior, get("specular_ior_level", 0.5), notes)
    bsdf["specular"] = min(f0 / 0.08, 1.0)
    through = get("transmission_weight", 0.0)
    if through == 0 and get("metallic", 0.0) == 0:
        rough = closure["roughness"] if is_number(closure["roughness"]) else 0.5
        base = scaled(closure["base_color"], layer_factor(rough, bsdf["specular"]))
        bsdf["base_color"] = texture(base, "color")
    if through != 0:
        del bsdf["specular"]
        bsdf |= {"spec_trans": texture(through, "value"), "eta": max(ior, 1.001)}
    if get("anisotropic", 0.0) != 0:
        bsdf["anisotropic"] = texture(closure["anisotropic"], "value")
    if get("sheen_weight", 0.0) != 0:
        bsdf["sheen"] = texture(closure["sheen_weight"], "value")
        notes.append("sheen of another model")
    if get("coat_weight", 0.0) != 0:
        bsdf["clearcoat"] = texture(closure["coat_weight"], "value")
        rough = closure["coat_roughness"] if is_number(closure["coat_roughness"]) else 0.03
        bsdf["clearcoat_gloss"] = min(max((0.1 - rough**2) / 0.099, 0.0), 1.0)
        notes.append("coat a quarter as strong")
    return Material(bsdf, two_sided=through == 0, notes=notes)

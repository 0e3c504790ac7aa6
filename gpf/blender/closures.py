"""Blender's single closures as Mitsuba's BSDFs: diffuse, glossy, glass, emission and so on."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from gpf.blender.energy import glass_factor, metal_colour

Closure = Mapping[str, Any]
Dict = dict[str, Any]

SMOOTH = 0.02
"""Blender's roughness below which a surface is a mirror or clear glass."""

Texture = Callable[[Any, str], Any]
"""Maps an input and its role, "color", "value" or "normal", to a value of a Mitsuba dictionary."""


@dataclass
class Material:
    """A BSDF, its emission, and how close it is.

    Attributes
    ----------
    bsdf: a dictionary for `mi.load_dict`.
    emission: radiance, a texture of Mitsuba or None.
    two_sided: whether `bsdf` must be wrapped to reflect on both sides.
    opacity: None if opaque; otherwise a number or texture.
    medium: what is behind the surface, a dictionary for `mi.load_dict`, or None.
    notes: what is approximated, and how.
    """

    bsdf: Dict
    emission: Any = None
    two_sided: bool = True
    opacity: Any = None
    medium: Dict | None = None
    notes: list[str] = field(default_factory=list)

    def whole(self) -> Dict:
        """The BSDF with both sides and its opacity."""
        found = {"type": "twosided", "bsdf": self.bsdf} if self.two_sided else self.bsdf
        if self.opacity is not None:
            found = {"type": "mask", "opacity": self.opacity, "bsdf": found}
        return found


def is_number(value: Any) -> bool:
    """Whether an input is a single number."""
    return isinstance(value, (int, float))


def make_diffuse(closure: Closure, texture: Texture) -> Material:
    """A diffuse surface."""
    notes = []
    if closure.get("roughness", 0) != 0:
        notes.append("rough diffuse surface as a smooth one")
    bsdf = {"type": "diffuse", "reflectance": texture(closure["color"], "color")}
    return Material(bsdf, notes=notes)


def make_black(closure: Closure, texture: Texture) -> Material:
    """A surface that reflects nothing."""
    return Material({"type": "diffuse", "reflectance": _rgb([0, 0, 0])})


def make_glossy(closure: Closure, texture: Texture) -> Material:
    """A mirror, or rough metal."""
    colour, roughness = closure["color"], closure["roughness"]
    if not is_number(roughness):
        return make_metal(closure, texture)
    if roughness < SMOOTH:
        mirror: Dict = {"type": "conductor", "material": "none"}
        return Material(mirror | {"specular_reflectance": texture(colour, "color")})
    notes: list[str] = []
    colour = _metallic_colour(colour, roughness, texture, notes)
    bsdf: Dict = {"type": "roughconductor", "material": "none", "distribution": "ggx"}
    bsdf["alpha"], bsdf["specular_reflectance"] = _alpha(roughness, notes), colour
    return Material(bsdf, notes=notes)


def make_metal(closure: Closure, texture: Texture) -> Material:
    """Rough metal, whose colour and roughness may be images."""
    notes: list[str] = []
    colour = closure.get("base_color", closure.get("color"))
    colour = _metallic_colour(colour, closure["roughness"], texture, notes)
    bsdf = {"type": "principled", "base_color": colour, "metallic": 1.0}
    bsdf["roughness"] = texture(closure["roughness"], "value")
    return Material(bsdf, notes=notes)


def _metallic_colour(colour: Any, roughness: Any, texture: Texture, notes: list[str]) -> Any:
    """The corrected colour of rough metal; for images, with one factor for all of it."""
    rough = roughness if is_number(roughness) else 0.5
    if isinstance(colour, list):
        corrected = [metal_colour(c, rough) for c in colour]
        if max(corrected) > 1.02:
            notes.append("darker: light that bounces within rough metal is lost")
        return texture(corrected, "color")
    return texture(scaled(colour, metal_colour(0.7, rough) / 0.7), "color")


def scaled(value: Any, factor: float) -> Any:
    """An input times a factor, unless that is about one."""
    if isinstance(value, list):
        return [factor * v for v in value]
    if abs(factor - 1) < 0.01 or "attribute" in value:
        return value
    return dict(value) | {"scale": [factor * v for v in value.get("scale", [1.0, 1.0, 1.0])]}


def make_glass(closure: Closure, texture: Texture) -> Material:
    """Glass: Blender's node tints both ways, Principled only what passes."""
    notes: list[str] = []
    ior = closure["ior"] if is_number(closure["ior"]) else 1.45
    bsdf: Dict = {"int_ior": float(ior), "ext_ior": 1.0}
    roughness, colour, factor = closure["roughness"], closure["color"], 1.0
    if is_number(roughness) and roughness < SMOOTH:
        bsdf["type"] = "dielectric"
    else:
        bsdf |= {"type": "roughdielectric", "distribution": "ggx"}
        bsdf["alpha"] = _alpha(roughness, notes)
        factor = glass_factor(roughness if is_number(roughness) else 0.5, float(ior))
        if isinstance(colour, list) and factor * max(colour) > 1.02:
            notes.append("darker: light that bounces within rough glass is lost")
    bsdf["specular_transmittance"] = texture(scaled(colour, factor), "color")
    if closure["closure"] == "refraction":
        bsdf["specular_reflectance"] = _rgb([0, 0, 0])
        notes.append("refraction without reflection as glass that absorbs what it reflects")
    elif closure["closure"] == "glass":
        bsdf["specular_reflectance"] = bsdf["specular_transmittance"]
    return Material(bsdf, two_sided=False, notes=notes)


def _alpha(roughness: Any, notes: list[str]) -> float:
    """Mitsuba's α for a roughness, which must be a number there."""
    if not is_number(roughness):
        notes.append("textured roughness as its mean, 0.5")
        roughness = 0.5
    return float(max(roughness, 0.0) ** 2)


def make_translucent(closure: Closure, texture: Texture) -> Material:
    """A surface that lets all light through, diffusely."""
    bsdf = {"type": "principledthin", "base_color": texture(closure["color"], "color")}
    bsdf |= {"diff_trans": 2.0, "eta": 1.001, "roughness": 1.0}
    return Material(bsdf, two_sided=False)


def make_transparent(closure: Closure, texture: Texture) -> Material:
    """A surface that light passes straight, and that may colour it."""
    colour = closure["color"]
    if isinstance(colour, list) and min(colour) >= 1:
        return Material({"type": "null"}, two_sided=False)
    bsdf = {"type": "thindielectric", "int_ior": 1.0001, "ext_ior": 1.0}
    return Material(bsdf | {"specular_transmittance": texture(colour, "color")}, two_sided=False)


def make_emission(closure: Closure, texture: Texture) -> Material:
    """A surface that emits and does not reflect."""
    found = make_black(closure, texture)
    found.emission = radiance(closure["color"], closure["strength"], texture, found.notes)
    return found


def radiance(colour: Any, strength: Any, texture: Texture, notes: list[str]) -> Any:
    """The radiance of an emission, W/(m² sr), or None if there is none."""
    if not is_number(strength):
        notes.append("textured strength of emission as 1")
        strength = 1.0
    if strength == 0 or (isinstance(colour, list) and not any(colour)):
        return None
    if isinstance(colour, list):
        return {"type": "rgb", "value": [float(c * strength) for c in colour]}
    return texture(scaled(colour, strength), "radiance")


def _rgb(value: Any) -> Dict:
    return {"type": "rgb", "value": [min(max(float(v), 0.0), 1.0) for v in value]}

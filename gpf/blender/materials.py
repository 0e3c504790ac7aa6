"""Blender's closures as Mitsuba's BSDFs.

``program/nodes.py`` describes closures and their inputs. What Mitsuba cannot express is
approximated, and a note says how.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from gpf.blender.energy import glass_factor, layer_factor, layer_share, metal_colour

Closure = Mapping[str, Any]
Dict = dict[str, Any]

SMOOTH = 0.02
"""Blender's roughness below which a surface is a mirror or clear glass."""

DULL = 0.75
"""Roughness from which the reflection of a dielectric layer is as good as diffuse."""

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
    notes: what is approximated, and how.
    """

    bsdf: Dict
    emission: Any = None
    two_sided: bool = True
    opacity: Any = None
    notes: list[str] = field(default_factory=list)

    def whole(self) -> Dict:
        """The BSDF with both sides and its opacity."""
        found = {"type": "twosided", "bsdf": self.bsdf} if self.two_sided else self.bsdf
        if self.opacity is not None:
            found = {"type": "mask", "opacity": self.opacity, "bsdf": found}
        return found


def translate(closure: Closure, texture: Texture) -> Material:
    """The material of a closure."""
    make = _MAKERS.get(closure["closure"], _other)
    found = make(closure, texture)
    if "normal" in closure and found.bsdf["type"] not in ("null", "dielectric"):
        found.bsdf = {
            "type": "normalmap",
            "normalmap": texture(closure["normal"], "normal"),
            "bsdf": found.bsdf,
        }
    if closure.get("volume"):
        found.notes.append("volume left out")
    return found


def is_number(value: Any) -> bool:
    """Whether an input is a single number."""
    return isinstance(value, (int, float))


def _rgb(value: Any) -> Dict:
    return {"type": "rgb", "value": [min(max(float(v), 0.0), 1.0) for v in value]}


def _diffuse(closure: Closure, texture: Texture) -> Material:
    notes = []
    if closure.get("roughness", 0) != 0:
        notes.append("rough diffuse surface as a smooth one")
    bsdf = {"type": "diffuse", "reflectance": texture(closure["color"], "color")}
    return Material(bsdf, notes=notes)


def _black(closure: Closure, texture: Texture) -> Material:
    return Material({"type": "diffuse", "reflectance": _rgb([0, 0, 0])})


def _alpha(roughness: Any, notes: list[str]) -> float:
    """Mitsuba's α for a roughness, which must be a number there."""
    if not is_number(roughness):
        notes.append("textured roughness as its mean, 0.5")
        roughness = 0.5
    return float(max(roughness, 0.0) ** 2)


def _glossy(closure: Closure, texture: Texture) -> Material:
    colour, roughness = closure["color"], closure["roughness"]
    if not is_number(roughness):
        return _metal(closure, texture)
    if roughness < SMOOTH:
        mirror: Dict = {"type": "conductor", "material": "none"}
        return Material(mirror | {"specular_reflectance": texture(colour, "color")})
    notes: list[str] = []
    colour = _metallic_colour(colour, roughness, texture, notes)
    bsdf: Dict = {"type": "roughconductor", "material": "none", "distribution": "ggx"}
    bsdf["alpha"], bsdf["specular_reflectance"] = _alpha(roughness, notes), colour
    return Material(bsdf, notes=notes)


def _metal(closure: Closure, texture: Texture) -> Material:
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
    return texture(_scaled(colour, metal_colour(0.7, rough) / 0.7), "color")


def _scaled(value: Any, factor: float) -> Any:
    """An input times a factor, unless that is about one."""
    if isinstance(value, list):
        return [factor * v for v in value]
    if abs(factor - 1) < 0.01 or "attribute" in value:
        return value
    return dict(value) | {"scale": factor}


def _glass(closure: Closure, texture: Texture) -> Material:
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
    bsdf["specular_transmittance"] = texture(_scaled(colour, factor), "color")
    if closure["closure"] == "refraction":
        bsdf["specular_reflectance"] = _rgb([0, 0, 0])
        notes.append("refraction without reflection as glass that absorbs what it reflects")
    elif closure["closure"] == "glass":
        bsdf["specular_reflectance"] = bsdf["specular_transmittance"]
    return Material(bsdf, two_sided=False, notes=notes)


def _translucent(closure: Closure, texture: Texture) -> Material:
    bsdf = {"type": "principledthin", "base_color": texture(closure["color"], "color")}
    bsdf |= {"diff_trans": 2.0, "eta": 1.001, "roughness": 1.0}
    return Material(bsdf, two_sided=False)


def _transparent(closure: Closure, texture: Texture) -> Material:
    colour = closure["color"]
    if isinstance(colour, list) and min(colour) >= 1:
        return Material({"type": "null"}, two_sided=False)
    bsdf = {"type": "thindielectric", "int_ior": 1.0001, "ext_ior": 1.0}
    return Material(bsdf | {"specular_transmittance": texture(colour, "color")}, two_sided=False)


def _emission(closure: Closure, texture: Texture) -> Material:
    found = _black(closure, texture)
    found.emission = _radiance(closure["color"], closure["strength"], texture, found.notes)
    return found


def _radiance(colour: Any, strength: Any, texture: Texture, notes: list[str]) -> Any:
    """The radiance of an emission, W/(m² sr), or None if there is none."""
    if not is_number(strength):
        notes.append("textured strength of emission as 1")
        strength = 1.0
    if strength == 0 or (isinstance(colour, list) and not any(colour)):
        return None
    if isinstance(colour, list):
        return {"type": "rgb", "value": [float(c * strength) for c in colour]}
    return texture(dict(colour) | {"scale": strength}, "radiance")


def _principled(closure: Closure, texture: Texture) -> Material:
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
        found = _glass(clear, texture)
    elif through == 0 and metallic == 0 and _is_smooth(closure):
        found = _plastic(closure, texture, ior)
    elif through == 0 and metallic == 0 and _is_dull(closure):
        found = _dull(closure, texture, ior, notes)
    elif through == 0 and metallic == 1:
        found = _metal(closure, texture)
    else:
        found = _disney(closure, texture, ior, notes)
    notes += [note for note in found.notes if note not in notes]
    found.notes = notes
    strength = get("emission_strength", 0.0)
    found.emission = _radiance(get("emission_color", [1, 1, 1]), strength, texture, notes)
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
        colour = dict(colour) | {"scale": 1 - a, "offset": a}
    return Material({"type": "diffuse", "reflectance": texture(colour, "color")})


def _reflectance(ior: float, level: Any, notes: list[str]) -> float:
    """F₀ of a dielectric whose reflection is scaled by twice ``level``."""
    if not is_number(level):
        notes.append("textured specular level as 0.5")
        level = 0.5
    return float(min(((ior - 1) / (ior + 1)) ** 2 * 2 * level, 0.99))


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
        base = _scaled(closure["base_color"], layer_factor(rough, bsdf["specular"]))
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


def _mix(closure: Closure, texture: Texture) -> Material:
    factor = closure["factor"]
    first, second = closure["first"], closure["second"]
    if is_number(factor) and factor <= 0:
        return translate(first, texture)
    if is_number(factor) and factor >= 1:
        return translate(second, texture)
    a, b = translate(first, texture), translate(second, texture)
    if b.bsdf["type"] == "null":
        return _seen_through(a, texture({"minus": factor}, "value"))
    if a.bsdf["type"] == "null":
        return _seen_through(b, texture(factor, "value"))
    bsdf = {"type": "blendbsdf", "weight": texture(factor, "value")}
    found = Material(
        bsdf | {"a": a.whole(), "b": b.whole()}, two_sided=False, notes=a.notes + b.notes
    )
    found.emission = _mixed_emission(a.emission, b.emission, factor, found.notes)
    return found


def _seen_through(material: Material, opacity: Any) -> Material:
    if material.opacity is not None:
        material.notes.append("one of two opacities left out")
    material.opacity = opacity
    return material


def _mixed_emission(a: Any, b: Any, factor: Any, notes: list[str]) -> Any:
    if a is None and b is None:
        return None
    weight = factor if is_number(factor) else 0.5
    if not is_number(factor):
        notes.append("textured share of emission as its mean, 0.5")
    parts = [(a, 1 - weight), (b, weight)]
    colours = [(e["value"], w) for e, w in parts if e is not None and e["type"] == "rgb"]
    if len(colours) < sum(e is not None for e, _ in parts):
        notes.append("mixed emission of images as the first alone")
        return a if a is not None else b
    return {"type": "rgb", "value": [sum(w * e[k] for e, w in colours) for k in range(3)]}


def _add(closure: Closure, texture: Texture) -> Material:
    a, b = (translate(closure[key], texture) for key in ("first", "second"))
    light = {"emission", "none"}
    if closure["first"]["closure"] in light:
        a, b = b, a
        closure = {"second": closure["first"]}
    if closure["second"]["closure"] not in light:
        a = Material(
            {"type": "blendbsdf", "weight": 0.5, "a": a.whole(), "b": b.whole()},
            emission=a.emission,
            two_sided=False,
            notes=[*a.notes, *b.notes, "a sum of two surfaces as their mean"],
        )
    if b.emission is not None:
        a.emission = b.emission
    return a


def _other(closure: Closure, texture: Texture) -> Material:
    colour = texture(closure.get("color", [0.8, 0.8, 0.8]), "color")
    what = closure.get("node", closure["closure"])
    bsdf = {"type": "diffuse", "reflectance": colour}
    return Material(bsdf, notes=[f"{what} as a diffuse surface"])


_MAKERS: dict[str, Callable[[Closure, Texture], Material]] = {
    "none": _black,
    "diffuse": _diffuse,
    "glossy": _glossy,
    "metallic": _metal,
    "glass": _glass,
    "refraction": _glass,
    "translucent": _translucent,
    "transparent": _transparent,
    "emission": _emission,
    "principled": _principled,
    "mix": _mix,
    "add": _add,
}

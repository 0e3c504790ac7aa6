"""Blender's closures as Mitsuba's BSDFs.

``program/nodes.py`` describes closures and their inputs. What Mitsuba cannot express is
approximated, and a note says how.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from gpf.blender.closures import (
    Closure,
    Dict,
    Material,
    Texture,
    is_number,
    make_black,
    make_diffuse,
    make_emission,
    make_glass,
    make_glossy,
    make_metal,
    make_translucent,
    make_transparent,
    scaled,
)
from gpf.blender.media import make_medium
from gpf.blender.principled import make_principled

AMOUNTS = {"strength", "emission_strength", "specular_ior_level", "coat_weight", "sheen_weight"}
"""Inputs that are, beside colours, proportional to what a surface reflects or emits."""

ROUGH = {"conductor": "roughconductor", "dielectric": "roughdielectric", "plastic": "roughplastic"}


def translate(closure: Closure, texture: Texture) -> Material:
    """The material of a closure."""
    make = _MAKERS.get(closure["closure"], _make_other)
    found = make(closure, texture)
    if "normal" in closure and found.bsdf["type"] not in ("null", "dielectric"):
        found.bsdf = {
            "type": "normalmap",
            "normalmap": texture(closure["normal"], "normal"),
            "bsdf": found.bsdf,
        }
    if "volume" in closure:
        found.medium, notes = make_medium(closure["volume"])
        found.notes += notes
        if closure["closure"] == "none":  # nothing at the surface
            found.bsdf, found.two_sided = {"type": "null"}, False
    return found


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
    bsdf |= {"a": _blended(a), "b": _blended(b)}
    found = Material(bsdf, two_sided=False, notes=a.notes + b.notes)
    weight = factor if is_number(factor) else 0.5
    if not is_number(factor) and (a.emission or b.emission):
        found.notes.append("textured share of emission as its mean, 0.5")
    found.emission = _sum([(a.emission, 1 - weight), (b.emission, weight)], found.notes)
    return found


def _blended(material: Material) -> Dict:
    """A part of a `blendbsdf`, which weights what a mirror reflects by the density of the other
    part: mirrors are a little rough there."""
    inner = material.bsdf.get("bsdf", material.bsdf)
    if inner["type"] in ROUGH:
        inner |= {"type": ROUGH[inner["type"]], "alpha": 1e-3}
    return material.whole()


def _seen_through(material: Material, opacity: Any) -> Material:
    if material.opacity is not None:
        material.notes.append("one of two opacities left out")
    material.opacity = opacity
    return material


def _sum(parts: Sequence[tuple[Any, float]], notes: list[str]) -> Any:
    """The sum of emissions, each with its weight."""
    some = [(emission, weight) for emission, weight in parts if emission is not None]
    colours = [(e["value"], w) for e, w in some if e["type"] == "rgb"]
    if len(colours) < len(some):
        if len(some) > 1 or some[0][1] != 1:
            notes.append("mixed emission of images as the first alone")
        return some[0][0]
    total = [sum(w * e[k] for e, w in colours) for k in range(3)]
    return {"type": "rgb", "value": total} if some else None


def _add(closure: Closure, texture: Texture) -> Material:
    parts = [closure["first"], closure["second"]]
    if parts[0]["closure"] in ("emission", "none"):
        parts.reverse()
    if parts[1]["closure"] in ("emission", "none"):
        found, light = (translate(part, texture) for part in parts)
        found.emission = _sum([(found.emission, 1), (light.emission, 1)], found.notes)
        return found
    most = [_brightness(part) for part in parts]
    share = min(max(most[1] / max(sum(most), 1e-9), 0.01), 0.99)
    first, second = (_scaled(p, 1 / w) for p, w in zip(parts, (1 - share, share), strict=True))
    found = _mix({"factor": share, "first": first, "second": second}, texture)
    if sum(most) > 1 or any(word in str(parts) for word in ("'principled'", "'attribute'")):
        found.notes.append("a sum of two surfaces, approximated")
    return found


def _brightness(closure: Closure) -> float:
    """The most that a surface reflects and lets through, by its colours."""
    if "second" in closure:
        return max(_brightness(closure[key]) for key in ("first", "second"))
    colour = closure.get("base_color", closure.get("color", [0.8]))
    dark = closure["closure"] in ("emission", "none")
    return 0.0 if dark else max(colour) if isinstance(colour, list) else 1.0


def _scaled(closure: Closure, factor: float) -> Closure:
    """A surface that reflects and emits as many times as much."""
    found = dict(closure)
    for key, value in closure.items():
        if key in ("first", "second"):
            found[key] = _scaled(value, factor)
        elif key in ("color", "base_color") and closure["closure"] != "emission":
            found[key] = scaled(value, factor)
        elif key in AMOUNTS and is_number(value):
            found[key] = factor * value
    return found


def _make_other(closure: Closure, texture: Texture) -> Material:
    colour = texture(closure.get("color", [0.8, 0.8, 0.8]), "color")
    what = closure.get("node", closure["closure"])
    bsdf = {"type": "diffuse", "reflectance": colour}
    return Material(bsdf, notes=[f"{what} as a diffuse surface"])


_MAKERS: dict[str, Callable[[Closure, Texture], Material]] = {
    "none": make_black,
    "diffuse": make_diffuse,
    "glossy": make_glossy,
    "metallic": make_metal,
    "glass": make_glass,
    "refraction": make_glass,
    "translucent": make_translucent,
    "transparent": make_transparent,
    "emission": make_emission,
    "principled": make_principled,
    "mix": _mix,
    "add": _add,
}

"""Blender's closures as Mitsuba's BSDFs.

``program/nodes.py`` describes closures and their inputs. What Mitsuba cannot express is
approximated, and a note says how.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from gpf.blender.closures import (
    Closure,
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
)
from gpf.blender.media import make_medium
from gpf.blender.principled import make_principled


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

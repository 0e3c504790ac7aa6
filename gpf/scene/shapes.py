"""The shapes of a scene, those of its shape groups among them, and the parameters of its parts."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import mitsuba as mi


def all_shapes(scene: mi.Scene) -> list[mi.Shape]:
    """The shapes of a scene and of its shape groups, each once."""
    shapes = scene.shapes()
    if all(shape.class_name() != "Instance" for shape in shapes):
        return list(shapes)
    inner = [part for part in mi.traverse(scene).hierarchy if isinstance(part, mi.Shape)]
    return list(dict.fromkeys((*shapes, *inner)))


def parameters(thing: Any) -> Iterator[tuple[str, Any, Any]]:
    """The parameters of a part of a scene: their keys, values and owners. The loop of Mitsuba's
    ``traverse`` ends with an error where a plugin leaves one out, as `hair` does."""
    found = mi.traverse(thing)
    for key, facts in found.properties.items():
        if facts[0] is not None:
            yield key, found[key], facts[2]

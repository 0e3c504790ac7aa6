"""The shapes of a scene, those of its shape groups among them."""

from __future__ import annotations

import mitsuba as mi


def all_shapes(scene: mi.Scene) -> list[mi.Shape]:
    """The shapes of a scene and of its shape groups, each once."""
    shapes = scene.shapes()
    if all(shape.class_name() != "Instance" for shape in shapes):
        return list(shapes)
    inner = [part for part in mi.traverse(scene).hierarchy if isinstance(part, mi.Shape)]
    return list(dict.fromkeys((*shapes, *inner)))

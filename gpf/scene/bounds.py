"""The bounding box of a scene."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np


def bounding_box(scene: mi.Scene) -> np.ndarray:
    """Two opposite corners of the box around all shapes, world units, (2, 3); zeros without shapes.

    ``scene.bbox()`` is wrong if Mitsuba merged rectangles into a mesh on loading: the box of that
    mesh does not contain them.
    """
    boxes = np.array([shape_box(shape) for shape in scene.shapes()]).reshape(-1, 2, 3)
    known = np.isfinite(boxes).all(axis=(1, 2))
    if not known.any():
        return np.zeros((2, 3))
    return np.array([boxes[known, 0].min(axis=0), boxes[known, 1].max(axis=0)])


def shape_box(shape: mi.Shape) -> np.ndarray:
    """Two opposite corners of the box around a shape, world units, (2, 3); infinite if there is
    none."""
    if shape.class_name() == "Mesh" and shape.vertex_count():  # merged, or made in Python
        vertices = dr.unravel(mi.Point3f, shape.vertex_positions_buffer())
        return np.array([[float(reduce(v)[0]) for v in vertices] for reduce in (dr.min, dr.max)])
    box = shape.bbox()
    return np.array([box.min, box.max], dtype=float)


def scene_bounds(scene: mi.Scene) -> tuple[Any, Any]:
    """The corners of :func:`bounding_box` as two points."""
    lower, upper = (mi.ScalarPoint3f(corner.tolist()) for corner in bounding_box(scene))
    return lower, upper


def box_around(p: mi.Point3f) -> tuple[Any, Any]:
    """The corners of the box around points, (N, 3)."""
    corners = [[float(reduce(v)[0]) for v in p] for reduce in (dr.min, dr.max)]
    lower, upper = (mi.ScalarPoint3f(corner) for corner in corners)
    return lower, upper


def inside_box(p: mi.Point3f, bounds: tuple[Any, Any]) -> mi.Bool:
    """Which points lie in the box between two corners, (N,)."""
    lower, upper = (mi.Point3f(*(dr.opaque(mi.Float, v) for v in corner)) for corner in bounds)
    return dr.all((p >= lower) & (p <= upper))

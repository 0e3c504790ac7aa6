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
    corners = []
    for shape in scene.shapes():
        box = shape.bbox()
        if shape.class_name() == "Mesh" and shape.vertex_count():  # merged, or made in Python
            vertices = np.array(shape.vertex_positions_buffer()).reshape(-1, 3)
            corners += [vertices.min(axis=0), vertices.max(axis=0)]
        elif box.valid():
            corners += [np.array(box.min), np.array(box.max)]
    if not corners:
        return np.zeros((2, 3))
    return np.array([np.min(corners, axis=0), np.max(corners, axis=0)], dtype=float)


def scene_bounds(scene: mi.Scene) -> tuple[Any, Any]:
    """The corners of :func:`bounding_box` as two points."""
    lower, upper = (mi.ScalarPoint3f(corner.tolist()) for corner in bounding_box(scene))
    return lower, upper


def box_around(p: mi.Point3f) -> tuple[Any, Any]:
    """The corners of the box around points, (N, 3)."""
    corners = [[reduce(v)[0] for v in p] for reduce in (dr.min, dr.max)]
    lower, upper = (mi.ScalarPoint3f([float(v) for v in corner]) for corner in corners)
    return lower, upper


def inside_box(p: mi.Point3f, bounds: tuple[Any, Any]) -> mi.Bool:
    """Which points lie in the box between two corners, (N,)."""
    lower, upper = (mi.Point3f(*(dr.opaque(mi.Float, v) for v in corner)) for corner in bounds)
    return dr.all((p >= lower) & (p <= upper))

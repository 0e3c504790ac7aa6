"""Where a scene is: the box around its shapes."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np


def bounding_box(scene: mi.Scene) -> np.ndarray:
    """Two opposite corners of the box around all shapes, world units, (2, 3); zeros without any.

    ``scene.bbox()`` leaves out the rectangles that Mitsuba merges into one mesh when it loads a
    scene from a file: that mesh says that its box is empty.
    """
    corners = []
    for shape in scene.shapes():
        box = shape.bbox()
        if box.valid():
            corners += [np.array(box.min), np.array(box.max)]
        elif shape.is_mesh() and shape.vertex_count():
            vertices = np.array(shape.vertex_positions_buffer()).reshape(-1, 3)
            corners += [vertices.min(axis=0), vertices.max(axis=0)]
    if not corners:
        return np.zeros((2, 3))
    return np.array([np.min(corners, axis=0), np.max(corners, axis=0)], dtype=float)


def scene_bounds(scene: mi.Scene) -> tuple[Any, Any]:
    """The same as two points."""
    lower, upper = (mi.ScalarPoint3f(corner.tolist()) for corner in bounding_box(scene))
    return lower, upper


def require_bounds(scene: mi.Scene) -> None:
    """Raise a ``ValueError`` where photons from afar would miss a part of the scene.

    Emitters that are infinitely far away aim at the box that the scene had when it was loaded.
    """
    emitters = [e for e in scene.emitters() if mi.has_flag(e.flags(), mi.EmitterFlags.Infinite)]
    if emitters and not all(shape.bbox().valid() for shape in scene.shapes()):
        kinds = ", ".join(sorted({e.class_name() for e in emitters}))
        raise ValueError(
            "Mitsuba merged rectangles of this scene into a mesh that has no bounding box, so that "
            f"light from its {kinds} would miss them. Load it with "
            "mi.load_file(path, optimize=False)."
        )

"""Whether a field was made for the scene that it is rendered in."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import mitsuba as mi
import numpy as np

# Corners of the two bounding boxes may lie so far apart, as a share of the diagonal.
TOLERANCE = 1e-3


def warn_of_another_scene(scene: mi.Scene, bounds: Sequence[Sequence[float]]) -> None:
    """Warn, as Python does, where the scene's bounding box is not the one that a field has."""
    ours, theirs = bounding_box(scene), np.array(bounds)
    if near(ours, theirs):
        return
    # Whoever made a field of a scene with merged rectangles had this one.
    if near(np.array([scene.bbox().min, scene.bbox().max]), theirs):
        return
    warnings.warn(
        f"This field was made for another scene: that one reaches from {_words(theirs[0])} to "
        f"{_words(theirs[1])}, this one from {_words(ours[0])} to {_words(ours[1])}. What it "
        "answers here is the light of that scene.",
        stacklevel=2,
    )


def near(box: np.ndarray, other: np.ndarray) -> bool:
    """Whether two boxes, (2, 3) each, are the same but for the tolerance."""
    diagonal = max(np.linalg.norm(b[1] - b[0]) for b in (box, other))
    return bool(np.abs(box - other).max() <= TOLERANCE * diagonal)


def bounding_box(scene: mi.Scene) -> np.ndarray:
    """Two opposite corners of the box around all shapes, world units, (2, 3).

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


def _words(corner: np.ndarray) -> str:
    return "(" + ", ".join(f"{v:.4g}" for v in corner) + ")"

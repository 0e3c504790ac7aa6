"""Whether a field was made for the scene that it is rendered in."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import mitsuba as mi
import numpy as np

from gpf.scene.bounds import bounding_box

# Corners of the two bounding boxes may lie so far apart, as a share of the diagonal.
TOLERANCE = 1e-3


def warn_of_another_scene(scene: mi.Scene, bounds: Sequence[Sequence[float]]) -> None:
    """Warn, as Python does, where the scene's bounding box is not the one that a field has."""
    ours, theirs = bounding_box(scene), np.array(bounds)
    if near(ours, theirs):
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


def _words(corner: np.ndarray) -> str:
    return "(" + ", ".join(f"{v:.4g}" for v in corner) + ")"

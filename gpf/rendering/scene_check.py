"""Checks whether a field was made for the scene in which it is rendered."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import mitsuba as mi
import numpy as np

from gpf.scene.bounds import bounding_box
from gpf.scene.fingerprint import changed_parts, fingerprint

# Largest distance between corners of the two bounding boxes, as a share of the diagonal.
TOLERANCE = 1e-3


class SceneCheck:
    """Warns once for each pair of scene and field that do not belong together."""

    def __init__(self) -> None:
        self._compared: tuple[list[mi.Shape], list[list[float]]] | None = None

    def compare(self, scene: mi.Scene, field: Any) -> None:
        """Compare a scene with a field, or with another system in a field's place."""
        bounds = [[float(v) for v in corner] for corner in field.bounds]
        if self._compared == (scene.shapes(), bounds):
            return
        self._compared = scene.shapes(), bounds
        known = dict(getattr(field, "record", {}).get("fingerprint") or {})
        if getattr(field, "lights", None) is not None:
            known.pop("lights", None)  # they may be dimmed (gpf.rendering.lights)
        warn_of_another_scene(scene, bounds, known)


def warn_of_another_scene(
    scene: mi.Scene, bounds: Sequence[Sequence[float]], known: Mapping[str, Any] | None = None
) -> None:
    """Give a Python warning if the scene's bounding box differs from the field's, or its contents
    from ``known``, the fingerprint of the field's scene."""
    ours, theirs = bounding_box(scene), np.array(bounds)
    if not near(ours, theirs):
        warnings.warn(
            f"This field was made for another scene: that scene extends from {_format(theirs[0])} "
            f"to {_format(theirs[1])}, this one from {_format(ours[0])} to {_format(ours[1])}. The "
            "image shows the light of that scene.",
            stacklevel=2,
        )
    elif known and (changed := changed_parts(known, fingerprint(scene))):
        warnings.warn(
            f"This field was made for this scene before it was changed: different "
            f"{', '.join(changed)}. The image shows the earlier light.",
            stacklevel=2,
        )


def near(box: np.ndarray, other: np.ndarray) -> bool:
    """Whether two boxes, (2, 3) each, are the same within the tolerance."""
    diagonal = max(np.linalg.norm(b[1] - b[0]) for b in (box, other))
    return bool(np.abs(box - other).max() <= TOLERANCE * diagonal)


def _format(corner: np.ndarray) -> str:
    return "(" + ", ".join(f"{v:.4g}" for v in corner) + ")"

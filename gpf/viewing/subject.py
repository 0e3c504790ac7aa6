"""What the viewer shows: a scene with its cameras."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

import mitsuba as mi

from gpf.scene.views import Keyframe, View
from gpf.viewing.references import References


@dataclass
class Subject:
    """A scene with its cameras.

    Attributes
    ----------
    title: name of the scene.
    cameras: cameras that pages can jump to, with ``fov`` across x; they start at the first.
    aspect: width divided by height of the cameras' pictures.
    exposure: None to measure it in the first picture.
    views_file: where cameras are saved.
    """

    scene: mi.Scene
    title: str
    cameras: list[View]
    aspect: float
    exposure: float | None
    views_file: Path
    references: References = field(default_factory=References)

    def framed(self, camera: Keyframe, aspect: float | None) -> Keyframe:
        """The camera for pictures of another aspect: they show all that its own do, in the middle,
        and what is beside it, or above and below."""
        if aspect is None:
            return camera
        wider = max(1.0, aspect / self.aspect)
        higher = wider * self.aspect / aspect
        fov = 2 * math.degrees(math.atan(wider * math.tan(math.radians(camera.fov) / 2)))
        shift = camera.shift[0] / wider, camera.shift[1] / higher
        return camera.model_copy(update={"fov": fov, "shift": shift})

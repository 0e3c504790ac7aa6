"""What the viewer shows: a scene with its cameras."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import mitsuba as mi

from gpf.scene.views import View
from gpf.viewing.references import References


@dataclass
class Subject:
    """A scene with its cameras.

    Attributes
    ----------
    title: name of the scene.
    cameras: cameras that pages can jump to, with ``fov`` across x; they start at the first.
    aspect: width divided by height of all pictures.
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

"""What a system that the field is compared with is given, and what it has to do.

A system is prepared once for a scene, from the scene itself or from images of training views, and
then renders views that it has not seen. What it cannot serve it refuses in words, with
:class:`CannotServe`: the reason is its entry in the tables.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import mitsuba as mi
import numpy as np

from gpf.core.errors import UserError
from gpf.rendering.settings import RenderSettings
from gpf.scene.views import View
from gpf.training.settings import TrainingSettings


class CannotServe(UserError):
    """A system cannot render a scene, here or at all; ``what`` is the reason that tables show."""


@dataclass(frozen=True)
class TrainingView:
    """A camera and what it sees.

    Attributes
    ----------
    view: the camera.
    layers: what the reference of the view has, float32: ``radiance`` (H, W, 3) in W/(m² sr),
        linear; ``position`` and ``normal`` of the first diffuse hit, (H, W, 3), world units; and
        ``valid`` (H, W), 1 where there is one.
    """

    view: View
    layers: Mapping[str, np.ndarray]

    @property
    def radiance(self) -> np.ndarray:
        """The reference image, (H, W, 3), linear."""
        return self.layers["radiance"]


@dataclass(frozen=True)
class Task:
    """A scene to be served.

    Attributes
    ----------
    name: the scene's name, for messages.
    scene: the scene, loaded with ids and shapes as in its file.
    file: that file.
    size: width and height of all images, pixels.
    exposure: what linear images are multiplied by before they are shown or compared.
    training: views with their references, as many as the system asked for.
    targets: the file of the points that the field learns from (:mod:`gpf.training.targets`), for systems
        that learn from the same.
    rr_depth: interactions before Russian roulette, where the system walks paths.
    seed: of all that is random in the preparation.
    state: a folder, which is there, where the preparation may keep what a killed run would lose.
        Once all views are rendered it is emptied, but for what was learned.
    train, render: how the field is trained and rendered, for systems that are to have as much.
    seconds_per_view: what a view of the field costs, for systems that are to take as long.
    report: called with how much of the preparation is done, and of how much.
    """

    name: str
    scene: mi.Scene
    file: Path
    size: tuple[int, int]
    exposure: float
    training: tuple[TrainingView, ...]
    targets: Path
    rr_depth: int
    seed: int
    state: Path
    train: TrainingSettings = TrainingSettings()
    render: RenderSettings = RenderSettings()
    seconds_per_view: float | None = None
    report: Callable[[int, int], None] = lambda done, total: None


class Prepared(Protocol):
    """A system that is ready for any view of its scene."""

    @property
    def storage_bytes(self) -> int:
        """What has to be kept to render further views, beside the scene; 0 for a path tracer."""

    @property
    def facts(self) -> Mapping[str, float | str]:
        """What tables or people may want to know: steps made, primitives, what ran on what."""

    def render(self, view: View, seed: int) -> np.ndarray:
        """A view's radiance, W/(m² sr), (H, W, 3) float32, linear."""


class Baseline(Protocol):
    """A system with its options from params.yaml."""

    def prepare(self, task: Task) -> Prepared:
        """Make ready for a scene.

        Goes on from what an earlier call with the same task and options left in ``task.state``.

        Raises
        ------
        CannotServe: the scene is beyond the system, or a package or weights are missing.
        """

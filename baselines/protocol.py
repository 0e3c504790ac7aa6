"""The protocol of the systems that the field is compared with.

A system is prepared once for a scene, from the scene itself or from images of training views, and
then renders other views. If it cannot render a scene it raises :class:`CannotServe`, whose reason
is shown in the tables.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import mitsuba as mi
import numpy as np

from gpf.core.errors import UserError, without_folders
from gpf.rendering.settings import RenderSettings
from gpf.scene.media import Media
from gpf.scene.views import View
from gpf.training.settings import TrainingSettings


class CannotServe(UserError):
    """A system cannot render a scene, here or at all; ``what`` is the reason that tables show.

    The message may name folders on this machine; ``where``, ``what`` and ``todo``, which are
    written to files, do not.
    """

    def __init__(self, where: str, what: str, todo: str) -> None:
        super().__init__(where, what, todo)
        self.told = what
        """``what`` for the terminal, with folders."""
        self.where, self.what, self.todo = map(without_folders, (where, what, todo))


def refuse_media(scene: mi.Scene, name: str) -> None:
    """Raise :class:`CannotServe` if a scene has media, for systems that know surfaces only."""
    if Media(scene).there:
        raise CannotServe(
            f"scene {name}", "has media, in which the system has no light", "Leave it out here."
        )


@dataclass(frozen=True)
class TrainingView:
    """A camera and its reference.

    Attributes
    ----------
    view: the camera.
    layers: layers of the reference, float32: ``radiance`` (H, W, 3) in W/(m² sr), linear;
        ``position`` and ``normal`` of the first diffuse hit, (H, W, 3), world units; ``valid``
        (H, W), 1 where there is such a hit.
    """

    view: View
    layers: Mapping[str, np.ndarray]

    @property
    def radiance(self) -> np.ndarray:
        """The reference image, (H, W, 3), linear."""
        return self.layers["radiance"]


@dataclass(frozen=True)
class SharedField:
    """What the field shares with other systems.

    Attributes
    ----------
    targets: file of its targets (:mod:`gpf.training.targets`), for systems that learn from them.
    train, render: its settings, for systems that spend the same effort.
    file: the trained field, for systems that render it.
    """

    targets: Path | None = None
    train: TrainingSettings = TrainingSettings()
    render: RenderSettings = RenderSettings()
    file: Path | None = None


@dataclass(frozen=True)
class Task:
    """A scene that a system is to render.

    Attributes
    ----------
    name: the scene's name, for messages.
    scene: the scene, loaded with the ids and shapes of its file.
    file: the scene file.
    size: width and height of all images, pixels.
    exposure: factor for linear images before they are shown or compared.
    training: views with their references, as many as the system asks for.
    rr_depth: interactions before Russian roulette, for systems that trace paths.
    seed: random seed of the preparation.
    state: an existing folder for checkpoints of the preparation. It is emptied after the views are
        rendered, unless the system learns something that further views need.
    field: what the field shares with the system.
    seconds_per_view: the field's time per view, for systems with ``equal_time``.
    report: called as ``report(done, total)`` during the preparation.
    """

    name: str
    scene: mi.Scene
    file: Path
    size: tuple[int, int]
    exposure: float
    training: tuple[TrainingView, ...]
    rr_depth: int
    seed: int
    state: Path
    field: SharedField = SharedField()
    seconds_per_view: float | None = None
    report: Callable[[int, int], None] = lambda done, total: None


class Prepared(Protocol):
    """A system that is ready to render views of a scene."""

    @property
    def storage_bytes(self) -> int:
        """Bytes needed to render further views, apart from the scene; 0 for a path tracer."""

    @property
    def facts(self) -> Mapping[str, float | str]:
        """Further facts for tables and readers: steps, primitives, devices and the like."""

    def render(self, view: View, seed: int) -> np.ndarray:
        """A view's radiance, W/(m² sr), (H, W, 3) float32, linear."""


class Baseline(Protocol):
    """A system with its options."""

    def prepare(self, task: Task) -> Prepared:
        """Prepare the system for a scene.

        Continues from checkpoints left in ``task.state`` by a call with the same task and options.

        Raises
        ------
        CannotServe: the system cannot render the scene, or a package or weights are missing.
        """

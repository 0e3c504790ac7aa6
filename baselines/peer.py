"""Other renderers: they get a translated scene, render in their own process, and are given a time
per view."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from baselines.official import Program
from baselines.protocol import CannotServe, Task
from baselines.sampling import own_view
from baselines.translation.description import describe
from baselines.translation.nodes import read_file
from gpf.scene.pinhole import make_pinhole
from gpf.scene.views import View


def write_description(task: Task) -> Path:
    """Write the description of a task's scene (:mod:`baselines.translation.description`); its
    folder.

    Raises
    ------
    CannotServe: the scene has something that is not translated.
    """
    folder = task.state.absolute() / "scene"
    describe(read_file(task.file), task.scene, folder, str(task.file))
    return folder


def seconds_for(seconds: float | Literal["equal_time"], task: Task) -> float:
    """The time for a view that the options ask for.

    Raises
    ------
    CannotServe: it is the field's, which is unknown.
    """
    if seconds != "equal_time":
        return seconds
    if task.seconds_per_view is None:
        raise CannotServe(
            f"scene {task.name}",
            "the field's time per view is unknown, so there is no equal time",
            "Set `seconds_per_view`, or give a number of seconds.",
        )
    return task.seconds_per_view


@dataclass
class PreparedPeer:
    """A scene in another renderer.

    Attributes
    ----------
    seconds: for a view, all included.
    choices: further settings of a request, from the best to the fastest. The first that leaves a
        quarter of the time to the samples is used.
    overhead: what a view takes apart from its samples, such as denoising; measured.
    """

    task: Task
    program: Program
    seconds: float
    choices: Sequence[Mapping[str, Any]] = ({},)
    chosen: Mapping[str, Any] = field(default_factory=dict)
    overhead: float = 0.0
    megabytes: float = 0.0

    @property
    def storage_bytes(self) -> int:
        """0: nothing is kept between views."""
        return 0

    @property
    def facts(self) -> Mapping[str, float | str]:
        """``version``, ``device``, the choice, and the renderer's peak memory."""
        chosen = {k: v for k, v in self.chosen.items() if isinstance(v, (str, float))}
        return {**self.program.started, **chosen, "renderer_megabytes": self.megabytes}

    def measure(self) -> None:
        """Choose, and measure the overhead with the scene's own camera; this also loads the scene.

        Raises
        ------
        CannotServe: there is no time for samples, or the scene has no camera.
        """
        view = own_view(self.task)
        for choice in self.choices:
            self.chosen = choice
            taken: list[float] = []
            # The first may be slow; if it is very slow, the others will be, too.
            while len(taken) < 3 and (not taken or taken[0] < 2 * self.seconds):
                taken.append(self.ask(view, len(taken), {"samples": 1})["seconds"])
            self.overhead = min(taken)
            if self.overhead <= 0.75 * self.seconds:
                return
        if self.overhead >= self.seconds:
            raise CannotServe(
                f"scene {self.task.name}",
                f"a view may take {self.seconds:.3g} s, but one with a single sample per pixel "
                f"takes {self.overhead:.3g} s",
                "Give a longer time.",
            )

    def render(self, view: View, seed: int) -> np.ndarray:
        """A view's radiance, W/(m² sr), (H, W, 3) float32, linear.

        Raises
        ------
        CannotServe: the renderer fails, or its image has NaN or infinite values.
        """
        answer = self.ask(view, seed, {"seconds": self.seconds - self.overhead})
        self.megabytes = answer["peak_megabytes"]
        image: np.ndarray = np.load(answer["image"])
        if not np.isfinite(image).all():
            name = self.program.host.name
            raise CannotServe(
                name, "returned NaN or infinite values", "Report this to its authors."
            )
        return image

    def ask(self, view: View, seed: int, effort: Mapping[str, float]) -> dict[str, Any]:
        """Have a view rendered with ``seconds`` or ``samples``; the answer, and its ``image``."""
        camera = make_pinhole(view, self.task.size)
        described = {
            "origin": camera.origin.tolist(),
            "rotation": camera.rotation.tolist(),
            "focal": camera.focal,
            "size": list(camera.size),
            "centre": list(camera.centre),
        }
        image = str(self.task.state.absolute() / "image.npy")
        request = {"camera": described, "seed": seed, "image": image, **self.chosen, **effort}
        return {**self.program.ask(request), "image": image}

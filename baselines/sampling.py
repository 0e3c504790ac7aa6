"""Shared by the systems that trace paths: images of many samples, and the scene's own camera."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import mitsuba as mi
import numpy as np

from baselines.protocol import CannotServe, Task
from gpf.core.random import Stream, pass_seed
from gpf.rendering.batches import LARGEST_WAVEFRONT, mean_of_batches
from gpf.rendering.timed_sampling import sample_for
from gpf.scene.media import medium_at
from gpf.scene.sensors import make_sensor, views_of_sensors
from gpf.scene.views import View


@dataclass
class Samples:
    """The number of samples per pixel of a view.

    Attributes
    ----------
    number: samples per pixel; None for as many as fit into ``seconds``, which varies between runs.
    seconds: time for a whole view.
    alike: whether all parts have one sample (:func:`sample_for`).
    taken: samples per pixel of the views so far, if the clock decides.
    """

    number: int | None
    seconds: float = 0.0
    alike: bool = False
    taken: list[int] = field(default_factory=list)

    @classmethod
    def plan(cls, spp: int | Literal["equal_time"], task: Task) -> Samples:
        """The number of samples that the options ask for.

        Raises
        ------
        CannotServe: ``spp`` is ``equal_time``, and ``task.seconds_per_view`` is None.
        """
        if spp != "equal_time":
            return cls(int(spp))
        if task.seconds_per_view is None:
            raise CannotServe(
                f"scene {task.name}",
                "the field's time per view is unknown, so there is no equal time",
                "Set `seconds_per_view`, or give a number of samples.",
            )
        return cls(None, task.seconds_per_view)

    @property
    def spp(self) -> float:
        """Samples per pixel; if the clock decides, the mean over the views so far."""
        return self.number if self.number is not None else float(np.mean(self.taken or [0]))

    def trace(
        self, trace: Callable[[int, int], np.ndarray], seed: int, spent: float = 0.0
    ) -> np.ndarray:
        """Render an image.

        Parameters
        ----------
        trace: called as ``trace(spp, seed)``; returns an image.
        spent: seconds of the view's time that other work takes.
        """
        if self.number is not None:
            return trace(self.number, seed)
        image, spp = sample_for(
            self.seconds - spent,
            lambda spp, part: trace(spp, pass_seed(seed, part, Stream.TIMED_SAMPLES)),
            alike=self.alike,
        )
        self.taken.append(spp)
        return image


@dataclass(frozen=True)
class PreparedSampling:
    """A scene, a Mitsuba integrator, and the number of samples per pixel."""

    task: Task
    integrator: mi.Integrator
    samples: Samples

    @classmethod
    def make(
        cls,
        task: Task,
        integrator: mi.Integrator,
        spp: int | Literal["equal_time"],
        alike: bool = False,
    ) -> PreparedSampling:
        """Prepare a scene; ``equal_time`` compiles the kernels with the scene's own camera.

        Parameters
        ----------
        alike: whether the integrator is recompiled for each view and number of samples.

        Raises
        ------
        CannotServe: for ``equal_time``, ``task.seconds_per_view`` is None, or the scene has no
            camera of its own.
        """
        samples = Samples.plan(spp, task)
        samples.alike = alike
        if samples.number is None:
            sensor = own_camera(task)
            for few in (1, 2):  # one sample per pixel and several need different kernels
                render_in_batches(task.scene, integrator, sensor, few, task.seed)
        return cls(task, integrator, samples)

    @property
    def storage_bytes(self) -> int:
        """0: nothing is kept."""
        return 0

    @property
    def facts(self) -> Mapping[str, float | str]:
        """``spp``; for ``equal_time`` the mean over the views so far."""
        return {"spp": self.samples.spp}

    def render(self, view: View, seed: int) -> np.ndarray:
        """A view's radiance, W/(m² sr), (H, W, 3) float32, linear."""
        start = time.perf_counter()
        inside = medium_at(self.task.scene, view.origin)
        sensor = make_sensor(view, *self.task.size, medium=inside)
        return self.samples.trace(
            lambda spp, seed: render_in_batches(
                self.task.scene, self.integrator, sensor, spp, seed
            ),
            seed,
            time.perf_counter() - start,
        )


def render_in_batches(
    scene: mi.Scene,
    integrator: mi.Integrator,
    sensor: mi.Sensor,
    spp: int,
    seed: int,
    largest: int = LARGEST_WAVEFRONT,
) -> np.ndarray:
    """An image with ``spp`` samples per pixel and all channels, (H, W, C) float32: the mean of
    batches (:func:`mean_of_batches`)."""

    def render(share: int, seed: int) -> np.ndarray:
        image: Any = mi.render(scene, integrator=integrator, sensor=sensor, spp=share, seed=seed)
        return np.asarray(image.numpy())

    width, height = (int(n) for n in sensor.film().crop_size())
    return mean_of_batches(render, spp, seed, width * height, largest)


def own_camera(task: Task) -> mi.Sensor:
    """The scene's first camera, with the size of the task's images; raises as :func:`own_view`."""
    view = own_view(task)
    return make_sensor(view, *task.size, medium=medium_at(task.scene, view.origin))


def own_view(task: Task) -> View:
    """The view of the scene's first camera.

    Raises
    ------
    CannotServe: the scene has none.
    """
    views = views_of_sensors(task.scene)
    if not views:
        raise CannotServe(
            f"scene {task.name}",
            "has no perspective camera of its own, which is needed for measurements",
            "Add a <sensor> to it; it may be the camera of the first training view.",
        )
    return views[0]

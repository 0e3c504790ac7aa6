"""What the systems that trace paths have in common: images of many samples, and a camera to try."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import mitsuba as mi
import numpy as np

from gpf.baselines.protocol import CannotServe, Task
from gpf.baselines.timed_sampling import Samples
from gpf.importing.sensors import views_of_sensors
from gpf.seeds import pass_seed
from gpf.sensors import make_sensor
from gpf.views import View

# Samples that are in flight at once: some 2 GB of state.
LARGEST_WAVEFRONT = 1 << 26


@dataclass(frozen=True)
class PreparedSampling:
    """A scene, an integrator of Mitsuba, and how many samples its pixels get."""

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
        """For ``equal_time``, images of the scene's own camera compile the kernels beforehand.

        ``alike``: an integrator that is compiled anew for each view and number of samples.

        Raises
        ------
        CannotServe: the time of a view from the field is asked for, and not known; or the scene
            has no camera of its own then.
        """
        samples = Samples.plan(spp, task)
        samples.alike = alike
        if samples.number is None:
            sensor = own_camera(task)
            for few in (1, 2):  # a single sample has a kernel of its own
                render_radiance(task.scene, integrator, sensor, few, task.seed)
        return cls(task, integrator, samples)

    @property
    def storage_bytes(self) -> int:
        """Nothing is kept."""
        return 0

    @property
    def facts(self) -> Mapping[str, float | str]:
        """``spp``, for ``equal_time`` the mean over the views so far."""
        return {"spp": self.samples.spp}

    def render(self, view: View, seed: int) -> np.ndarray:
        """A view's radiance, W/(m² sr), (H, W, 3) float32, linear."""
        start = time.perf_counter()
        sensor = make_sensor(view, *self.task.size)
        return self.samples.trace(
            lambda spp, seed: render_radiance(self.task.scene, self.integrator, sensor, spp, seed),
            seed,
            time.perf_counter() - start,
        )


def render_radiance(
    scene: mi.Scene,
    integrator: mi.Integrator,
    sensor: mi.Sensor,
    spp: int,
    seed: int,
    largest: int = LARGEST_WAVEFRONT,
) -> np.ndarray:
    """An image of ``spp`` samples per pixel, (H, W, 3) float32.

    It is made in as many parts of independent samples as it takes for none of them to have more
    than ``largest`` samples; a part has at least one per pixel.
    """
    width, height = (int(n) for n in sensor.film().crop_size())
    total = np.zeros((height, width, 3))
    for part, share in enumerate(split_samples(spp, width * height, largest)):
        image: Any = mi.render(
            scene,
            integrator=integrator,
            sensor=sensor,
            spp=share,
            seed=pass_seed(seed, part, stream=0),
        )
        total += np.asarray(image.numpy(), dtype=np.float64) * (share / spp)
    return total.astype(np.float32)


def split_samples(spp: int, pixels: int, largest: int) -> list[int]:
    """Samples per pixel of each part, as equal as can be."""
    most = max(largest // pixels, 1)
    parts = -(-spp // most)
    return [(spp * (k + 1)) // parts - (spp * k) // parts for k in range(parts)]


def own_camera(task: Task) -> mi.Sensor:
    """The scene's first camera, with the film that all views have.

    Raises
    ------
    CannotServe: the scene has none.
    """
    views = views_of_sensors(task.scene)
    if not views:
        raise CannotServe(
            f"scene {task.name}",
            "has no perspective camera of its own, with which to take a pilot's measurements",
            "Add a <sensor> to it; it may be that of the first training view.",
        )
    return make_sensor(views[0], *task.size)

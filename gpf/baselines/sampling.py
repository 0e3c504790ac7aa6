"""What the systems that trace paths have in common: images of many samples, and a camera to try."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np

from gpf.baselines.protocol import CannotServe, Task
from gpf.importing.sensors import views_of_sensors
from gpf.seeds import pass_seed
from gpf.sensors import make_sensor

# Samples that are in flight at once: some 2 GB of state.
LARGEST_WAVEFRONT = 1 << 26


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

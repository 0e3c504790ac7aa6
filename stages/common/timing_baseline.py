"""The timing baseline: a simple image by Mitsuba in the same run, to compare times with."""

from __future__ import annotations

import time
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.scene.sensors import make_sensor
from gpf.scene.views import View

ROUNDS = 5
"""Number of timed images, after one more that may compile kernels."""


def time_path(scene: Any, view: View, size: tuple[int, int]) -> float:
    """Median seconds that ``path`` takes for a view, with max_depth 2 and one sample per pixel.

    A busy or slow machine affects this image and a method's image alike, so the ratio of their
    times says more about the method than the seconds do.

    Parameters
    ----------
    size: width and height, pixels.
    """
    integrator = mi.load_dict({"type": "path", "max_depth": 2})
    sensor = make_sensor(view, *size)
    seconds = []
    for _ in range(1 + ROUNDS):
        dr.sync_thread()
        start = time.perf_counter()
        # Always the same seed: for some samplers, another seed needs another kernel.
        dr.eval(mi.render(scene, integrator=integrator, sensor=sensor, spp=1, seed=0))
        dr.sync_thread()
        seconds.append(time.perf_counter() - start)
    return float(np.median(seconds[1:]))

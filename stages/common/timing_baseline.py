"""The unit that times are told in beside seconds: a simple image by Mitsuba, in the same run."""

from __future__ import annotations

import time
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.scene.sensors import make_sensor
from gpf.scene.views import View

ROUNDS = 5
"""Images whose median time is taken, after one that may compile kernels."""


def time_path(scene: Any, view: View, size: tuple[int, int]) -> float:
    """Seconds that a view by ``path`` with max_depth 2 and one sample per pixel takes.

    A machine that is busy or slow is that for this image and for a method's alike: their ratio
    says more about the method than seconds do.

    Parameters
    ----------
    size: width and height.
    """
    integrator = mi.load_dict({"type": "path", "max_depth": 2})
    sensor = make_sensor(view, *size)
    seconds = []
    for _ in range(1 + ROUNDS):
        dr.sync_thread()
        start = time.perf_counter()
        # One seed: another would be another kernel to some samplers.
        dr.eval(mi.render(scene, integrator=integrator, sensor=sensor, spp=1, seed=0))
        dr.sync_thread()
        seconds.append(time.perf_counter() - start)
    return float(np.median(seconds[1:]))

"""Particle tracing: Mitsuba's ``ptracer``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import mitsuba as mi
import numpy as np

from gpf.baselines.options import ParticleTracerOptions
from gpf.baselines.protocol import Task
from gpf.baselines.sampling import render_radiance
from gpf.sensors import make_sensor
from gpf.views import View


class ParticleTracer:
    """Paths from the lamps, each vertex of which is connected to the camera.

    Caustics on surfaces that the camera sees directly are its strength. A surface that only
    reflects or refracts in one direction cannot be connected to a pinhole: mirrors, glass and
    water, and all that is behind them, remain black whatever the number of samples.
    """

    def __init__(self, options: ParticleTracerOptions) -> None:
        self.options = options

    def prepare(self, task: Task) -> PreparedParticleTracer:
        """Nothing to do."""
        # As for ``path``: any length, and a depth of 1 or more for the roulette.
        depths = {"max_depth": -1, "rr_depth": max(task.rr_depth, 1)}
        integrator = mi.load_dict({"type": "ptracer"} | depths)
        return PreparedParticleTracer(task, integrator, self.options.spp)


@dataclass(frozen=True)
class PreparedParticleTracer:
    """A scene, and how many paths there are for each pixel."""

    task: Task
    integrator: mi.Integrator
    spp: int

    @property
    def storage_bytes(self) -> int:
        """Nothing is kept."""
        return 0

    @property
    def facts(self) -> Mapping[str, float | str]:
        """``spp``, and the ``paths`` that a whole image gets: they land where they please."""
        width, height = self.task.size
        return {"spp": self.spp, "paths": self.spp * width * height}

    def render(self, view: View, seed: int) -> np.ndarray:
        """A view's radiance, W/(m² sr), (H, W, 3) float32, linear."""
        sensor = make_sensor(view, *self.task.size)
        return render_radiance(self.task.scene, self.integrator, sensor, self.spp, seed)

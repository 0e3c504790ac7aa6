"""Particle tracing: Mitsuba's ``ptracer``."""

from __future__ import annotations

from collections.abc import Mapping

import mitsuba as mi

from gpf.baselines.options import ParticleTracerOptions
from gpf.baselines.protocol import Task
from gpf.baselines.sampling import PreparedSampling


class ParticleTracer:
    """Paths from the lamps, each vertex of which is connected to the camera.

    Caustics on surfaces that the camera sees directly are its strength. A surface that only
    reflects or refracts in one direction cannot be connected to a pinhole: mirrors, glass and
    water, and all that is behind them, remain black whatever the number of samples.
    """

    def __init__(self, options: ParticleTracerOptions) -> None:
        self.options = options

    def prepare(self, task: Task) -> PreparedSampling:
        """Nothing to do but what :meth:`PreparedSampling.make` does."""
        # As for ``path``: any length, and a depth of 1 or more for the roulette.
        depths = {"max_depth": -1, "rr_depth": max(task.rr_depth, 1)}
        integrator = mi.load_dict({"type": "ptracer"} | depths)
        # Mitsuba compiles it anew for each camera and number of samples.
        return PreparedParticleTracer.make(task, integrator, self.options.spp, alike=True)


class PreparedParticleTracer(PreparedSampling):
    """A scene, and how many paths there are for each pixel."""

    @property
    def facts(self) -> Mapping[str, float | str]:
        """``spp``, and the ``paths`` that a whole image gets: they land where they please."""
        width, height = self.task.size
        return {"spp": self.samples.spp, "paths": self.samples.spp * width * height}

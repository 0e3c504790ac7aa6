"""Particle tracing: Mitsuba's ``ptracer``."""

from __future__ import annotations

from collections.abc import Mapping

import mitsuba as mi

from baselines.options import ParticleTracerOptions
from baselines.protocol import Task, refuse_media
from baselines.sampling import PreparedSampling


class ParticleTracer:
    """Paths from the lamps, with each vertex connected to the camera.

    Its strength is caustics on surfaces that the camera sees directly. A surface that reflects or
    refracts in a single direction cannot be connected to a pinhole: mirrors, glass and water, and
    everything behind them, stay black with any number of samples.
    """

    def __init__(self, options: ParticleTracerOptions) -> None:
        self.options = options

    def prepare(self, task: Task) -> PreparedSampling:
        """See :meth:`PreparedSampling.make`; raises :class:`CannotServe` in scenes with media."""
        refuse_media(task.scene, task.name)
        # As for ``path``: paths of any length, Russian roulette from a depth of 1 or more.
        depths = {"max_depth": -1, "rr_depth": max(task.rr_depth, 1)}
        integrator = mi.load_dict({"type": "ptracer"} | depths)
        # Mitsuba compiles it again for each camera and each number of samples.
        return PreparedParticleTracer.make(task, integrator, self.options.spp, alike=True)


class PreparedParticleTracer(PreparedSampling):
    """A scene, and the number of light paths per pixel."""

    @property
    def facts(self) -> Mapping[str, float | str]:
        """``spp``, and ``paths`` for the whole image: a path can contribute to any pixel."""
        width, height = self.task.size
        return {"spp": self.samples.spp, "paths": self.samples.spp * width * height}

"""Path tracing: Mitsuba's ``path``, or ``volpathmis`` in scenes with media."""

from __future__ import annotations

import mitsuba as mi

from baselines.options import PathTracerOptions
from baselines.protocol import Task
from baselines.sampling import PreparedSampling
from gpf.scene.media import Media


class PathTracer:
    """Unidirectional path tracing with next event estimation.

    It finds a caustic (light that reaches a diffuse surface through glass or water) only by chance:
    when a camera path leaves the surface in a random direction, passes through the glass and hits
    the lamp. The smaller the lamp, the rarer this is, and the brighter the pixel where it happens.
    """

    def __init__(self, options: PathTracerOptions) -> None:
        self.options = options

    def prepare(self, task: Task) -> PreparedSampling:
        """See :meth:`PreparedSampling.make`."""
        integrator = make_path_integrator(task.scene, task.rr_depth)
        return PreparedSampling.make(task, integrator, self.options.spp)


def make_path_integrator(scene: mi.Scene, rr_depth: int) -> mi.Integrator:
    """An integrator for paths of any length, as in the references; ``rr_depth`` is at least 1."""
    kind = "volpathmis" if Media(scene).there else "path"
    return mi.load_dict({"type": kind, "max_depth": -1, "rr_depth": max(rr_depth, 1)})

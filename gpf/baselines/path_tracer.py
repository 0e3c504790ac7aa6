"""Path tracing: Mitsuba's ``path``."""

from __future__ import annotations

import mitsuba as mi

from gpf.baselines.options import PathTracerOptions
from gpf.baselines.protocol import Task
from gpf.baselines.sampling import PreparedSampling


class PathTracer:
    """Unidirectional path tracing with next event estimation.

    Light that reaches diffuse surfaces through glass or water, a caustic, is found by chance alone:
    when a path of the camera leaves the surface at random, gets through, and meets the lamp. The
    smaller the lamp, the less often, and the brighter the pixel that it happens in.
    """

    def __init__(self, options: PathTracerOptions) -> None:
        self.options = options

    def prepare(self, task: Task) -> PreparedSampling:
        """Nothing to do but what :meth:`PreparedSampling.make` does."""
        return PreparedSampling.make(task, make_path_integrator(task.rr_depth), self.options.spp)


def make_path_integrator(rr_depth: int) -> mi.Integrator:
    """Paths of any length, as the references have them; ``path`` wants a depth of 1 or more."""
    return mi.load_dict({"type": "path", "max_depth": -1, "rr_depth": max(rr_depth, 1)})

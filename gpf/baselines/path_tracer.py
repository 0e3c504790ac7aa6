"""Path tracing: Mitsuba's ``path``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import mitsuba as mi
import numpy as np

from gpf.baselines.options import PathTracerOptions
from gpf.baselines.protocol import Task
from gpf.baselines.sampling import render_radiance
from gpf.sensors import make_sensor
from gpf.views import View


class PathTracer:
    """Unidirectional path tracing with next event estimation.

    Light that reaches diffuse surfaces through glass or water, a caustic, is found by chance alone:
    when a path of the camera leaves the surface at random, gets through, and meets the lamp. The
    smaller the lamp, the less often, and the brighter the pixel that it happens in.
    """

    def __init__(self, options: PathTracerOptions) -> None:
        self.options = options

    def prepare(self, task: Task) -> PreparedPathTracer:
        """Nothing to do."""
        return PreparedPathTracer(task, make_path_integrator(task.rr_depth), self.options.spp)


@dataclass(frozen=True)
class PreparedPathTracer:
    """A scene, and how many samples its pixels get."""

    task: Task
    integrator: mi.Integrator
    spp: int

    @property
    def storage_bytes(self) -> int:
        """Nothing is kept."""
        return 0

    @property
    def facts(self) -> Mapping[str, float | str]:
        """``spp``."""
        return {"spp": self.spp}

    def render(self, view: View, seed: int) -> np.ndarray:
        """A view's radiance, W/(m² sr), (H, W, 3) float32, linear."""
        sensor = make_sensor(view, *self.task.size)
        return render_radiance(self.task.scene, self.integrator, sensor, self.spp, seed)


def make_path_integrator(rr_depth: int) -> mi.Integrator:
    """Paths of any length, as the references have them; ``path`` wants a depth of 1 or more."""
    return mi.load_dict({"type": "path", "max_depth": -1, "rr_depth": max(rr_depth, 1)})

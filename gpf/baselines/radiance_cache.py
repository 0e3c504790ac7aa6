"""Neural radiance cache: the field's query, with a hash grid and a network for its Gaussians.

Not a system of the paper, but the field's natural rival: a network in the place of the cache that
Müller and others (2021) query at the end of short paths, here fitted once and asked at the first
diffuse hit. All else is the field's own: the plugin ``gpf`` makes the same camera walk with the
same samples, the points and targets that it learns from are the same, with the same weights, and so
are the numbers of steps and of points in each. What differs is what is between the point and the
irradiance there, and how fast that is.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import mitsuba as mi
import numpy as np

from gpf.baselines.cached_irradiance import (
    CachedIrradiance,
    CacheShape,
    CacheTrainer,
    CacheTraining,
)
from gpf.baselines.fitting import digest
from gpf.baselines.hash_encoding import Cube, GridShape
from gpf.baselines.options import RadianceCacheOptions
from gpf.baselines.protocol import FieldEffort, Task
from gpf.bounds import bounding_box, scene_bounds
from gpf.field import FieldSettings
from gpf.parted_rendering import render_in_parts
from gpf.sensors import make_sensor
from gpf.structs import VisiblePoints, to_numpy
from gpf.supervision import Targets
from gpf.views import View

SHAPES = {
    "small": CacheShape(GridShape(8, 2, log2_entries=16, coarsest=8, finest=256), (32, 32)),
    "large": CacheShape(GridShape(8, 4, log2_entries=17, coarsest=8, finest=256), (64, 64)),
}

# Share of the scene that its cube is larger by: no position leaves it with its offset.
MARGIN = 0.02


class RadianceCache:
    """The system ``radiance_cache``."""

    def __init__(self, options: RadianceCacheOptions) -> None:
        self.options = options

    def prepare(self, task: Task) -> PreparedCache:
        """Fit the network to the targets that the field learns from."""
        effort, targets = effort_of(self.options, task), Targets.load(task.targets)
        points = targets.supervised_points(effort.points, "irradiance", effort.loss)
        unit = float(np.mean(targets.irradiance)) or 1.0
        cube = Cube.around(bounding_box(task.scene), MARGIN)
        model = CachedIrradiance(SHAPES[self.options.size], cube, unit, task.seed)
        settings = CacheTraining(steps=effort.steps, batch=effort.batch, seed=task.seed)
        trainer = CacheTrainer(model, points, settings)
        fingerprint = {
            "size": self.options.size,
            "effort": asdict(effort),
            "seed": task.seed,
            "targets": digest(targets.position, targets.normal, targets.irradiance),
        }
        trainer.run(task.state / "radiance_cache.safetensors", fingerprint, task.report)
        return PreparedCache(task, self.options.size, effort, model, trainer.held_out_error())


def effort_of(options: RadianceCacheOptions, task: Task) -> FieldEffort:
    """What the field is given, but for what a row says otherwise."""
    said = {key: getattr(options, key) for key in ("steps", "batch", "spp")}
    return replace(task.field, **{k: value for k, value in said.items() if value is not None})


@dataclass(frozen=True)
class CacheAsField:
    """What the plugin ``gpf`` asks of a field, answered by the network."""

    model: CachedIrradiance
    settings: FieldSettings
    bounds: tuple[Any, Any]

    def radiance(self, points: VisiblePoints) -> tuple[mi.Color3f, mi.Float]:
        """Radiance of camera rays, (N, 3); and a reach that says nothing, for there is none."""
        return points.radiance(self.model.irradiance(points.p, points.n)), mi.Float(0)


class PreparedCache:
    """A scene with its fitted network."""

    def __init__(
        self, task: Task, size: str, effort: FieldEffort, model: CachedIrradiance, error: float
    ) -> None:
        self._task, self._size, self._effort = task, size, effort
        self._model, self._error = model, error
        self._integrator = mi.load_dict(
            {
                "type": "gpf",
                "rr_depth": task.rr_depth,
                "glossy_walks": effort.glossy_walks,
                "adaptive": effort.adaptive,
                "suppress_fireflies": effort.suppress_fireflies,
            }
        )
        settings = FieldSettings(search_radius=1.0)  # it has none
        self._integrator.field = CacheAsField(model, settings, scene_bounds(task.scene))

    @property
    def storage_bytes(self) -> int:
        """All parameters, float32."""
        return sum(to_numpy(values).nbytes for values in self._model.parameters)

    @property
    def facts(self) -> Mapping[str, float | str]:
        """Steps, parameters and the error on held-out points, in units of the mean target."""
        return {
            "steps": self._effort.steps,
            "size": self._size,
            "parameters": self.storage_bytes // 4,
            "held_out_error": self._error,
        }

    def render(self, view: View, seed: int) -> np.ndarray:
        """A view, (H, W, 3), from the camera walks that the field's rendering would make."""
        width, height = self._task.size
        spp, sampler = self._effort.spp, self._effort.sampler
        sensor = make_sensor(view, width, height, spp=spp, sampler=sampler)
        return render_in_parts(self._task.scene, self._integrator, sensor, spp, seed)[..., :3]

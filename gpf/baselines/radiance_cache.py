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
from dataclasses import dataclass
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
from gpf.baselines.protocol import Task
from gpf.bounds import bounding_box, scene_bounds
from gpf.field import FieldSettings
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
        options = self.options
        targets = Targets.load(task.targets)
        points = targets.supervised_points("both", "irradiance", "relative")
        unit = float(np.mean(targets.irradiance))
        cube = Cube.around(bounding_box(task.scene), MARGIN)
        model = CachedIrradiance(SHAPES[options.size], cube, unit if unit > 0 else 1.0, task.seed)
        settings = CacheTraining(steps=options.steps, batch=options.batch, seed=task.seed)
        trainer = CacheTrainer(model, points, settings)
        fingerprint = {
            "options": options.model_dump(mode="json"),
            "seed": task.seed,
            "targets": digest(targets.position, targets.normal, targets.irradiance),
        }
        trainer.run(task.state / "radiance_cache.safetensors", fingerprint, task.report)
        return PreparedCache(task, options, model, trainer.held_out_error())


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
        self, task: Task, options: RadianceCacheOptions, model: CachedIrradiance, error: float
    ) -> None:
        self._task, self._options, self._model, self._error = task, options, model, error
        self._integrator = mi.load_dict(
            {"type": "gpf", "rr_depth": task.rr_depth, "adaptive": True}
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
            "steps": self._options.steps,
            "size": self._options.size,
            "parameters": self.storage_bytes // 4,
            "held_out_error": self._error,
        }

    def render(self, view: View, seed: int) -> np.ndarray:
        """A view, (H, W, 3), from the camera walks that the field's rendering would make."""
        width, height = self._task.size
        sensor = make_sensor(view, width, height, spp=self._options.spp, sampler="multijitter")
        image = mi.render(
            self._task.scene,
            integrator=self._integrator,
            sensor=sensor,
            spp=self._options.spp,
            seed=seed,
        )
        return np.asarray(image)[..., :3].astype(np.float32)

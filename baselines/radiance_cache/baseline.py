"""Neural radiance cache: the field's query with a hash grid and a network instead of Gaussians.

This system is not in the paper. It is like the network cache that Müller and others (2021) query at
the end of short paths, but it is fitted once and queried at the first diffuse hit. Everything else
is as for the field: the camera walks of the plugin ``gpf`` and their samples, the supervised points
with targets and weights, the number of steps, and the points per step. Only the function from a
point to its irradiance, and its speed, differ.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import mitsuba as mi
import numpy as np

from baselines.neural.fitting import digest
from baselines.neural.hash_encoding import Cube, GridShape
from baselines.options import RadianceCacheOptions
from baselines.protocol import Task, refuse_media
from baselines.radiance_cache.cached_irradiance import (
    CachedIrradiance,
    CacheShape,
    CacheTrainer,
    CacheTraining,
)
from baselines.sampling import render_in_batches
from gpf.core.structs import VisiblePoints, to_numpy
from gpf.field.settings import FieldSettings
from gpf.rendering.settings import RenderSettings
from gpf.scene.bounds import bounding_box, scene_bounds
from gpf.scene.sensors import make_sensor
from gpf.scene.views import View
from gpf.training.settings import TrainingSettings
from gpf.training.targets import Targets

SHAPES = {
    "small": CacheShape(GridShape(8, 2, log2_entries=16, coarsest=8, finest=256), (32, 32)),
    "large": CacheShape(GridShape(8, 4, log2_entries=17, coarsest=8, finest=256), (64, 64)),
}

# Margin of the cube as a fraction of the scene, so that offset positions stay inside.
MARGIN = 0.02


class RadianceCache:
    """The system ``radiance_cache``."""

    def __init__(self, options: RadianceCacheOptions) -> None:
        self.options = options

    def prepare(self, task: Task) -> PreparedCache:
        """Fit the network to the field's targets.

        Raises
        ------
        CannotServe: the scene has media.
        """
        refuse_media(task.scene, task.name)
        train, render = effort_of(self.options, task)
        assert task.field.targets is not None
        targets = Targets.load(task.field.targets)
        points = targets.supervised_points(train.points, "irradiance")
        unit = float(np.mean(targets.irradiance)) or 1.0
        cube = Cube.around(bounding_box(task.scene), MARGIN)
        model = CachedIrradiance(SHAPES[self.options.size], cube, unit, task.seed)
        settings = CacheTraining(steps=train.steps, batch=train.batch, seed=task.seed)
        trainer = CacheTrainer(model, points, settings)
        fingerprint = {
            "size": self.options.size,
            "effort": [train.model_dump(), render.model_dump()],
            "seed": task.seed,
            "targets": digest(targets.position, targets.normal, targets.irradiance),
        }
        trainer.run(task.state / "radiance_cache.safetensors", fingerprint, task.report)
        facts = {"steps": train.steps, "held_out_error": trainer.held_out_error()}
        return PreparedCache(task, self.options.size, render, model, facts)


def effort_of(options: RadianceCacheOptions, task: Task) -> tuple[TrainingSettings, RenderSettings]:
    """The field's training and render settings, with the values that the options set."""
    train = {k: v for k in ("steps", "batch") if (v := getattr(options, k)) is not None}
    render = {} if options.spp is None else {"spp": options.spp}
    shared = task.field
    return shared.train.model_copy(update=train), shared.render.model_copy(update=render)


@dataclass(frozen=True)
class CacheAsField:
    """The network in place of a field, for the plugin ``gpf``."""

    model: CachedIrradiance
    settings: FieldSettings
    bounds: tuple[Any, Any]
    volume: None = None  # no light in media

    def query(self, x: mi.Point3f, n: mi.Normal3f, active: mi.Bool) -> tuple[mi.Color3f, mi.Float]:
        """Irradiance, (N, 3), and 0 for the reach, which a network does not have."""
        return self.model.irradiance(x, n), mi.Float(0)

    def unfold(self, x: mi.Point3f) -> mi.Point3f:
        """Points in units of the finest cells: samples that are much closer share a query."""
        return mi.Point3f(self.model.cube.place(x) * self.model.grid.shape.finest)

    def reflect(self, points: VisiblePoints, value: mi.Color3f) -> mi.Color3f:
        """Radiance of camera rays, (N, 3), from the irradiance at their visible points."""
        return points.radiance(value)


class PreparedCache:
    """A scene with its fitted network."""

    def __init__(
        self,
        task: Task,
        size: str,
        settings: RenderSettings,
        model: CachedIrradiance,
        facts: Mapping[str, float],
    ) -> None:
        self._task, self._size, self._settings = task, size, settings
        self._model, self._facts = model, facts
        self._integrator = mi.load_dict(
            {
                "type": "gpf",
                "rr_depth": task.rr_depth,
                "adaptive": settings.adaptive,
                "suppress_fireflies": settings.suppress_fireflies,
            }
        )
        query = FieldSettings(search_radius=1.0)  # one of the finest cells
        self._integrator.field = CacheAsField(model, query, scene_bounds(task.scene))

    @property
    def storage_bytes(self) -> int:
        """Bytes of all parameters, float32."""
        return sum(to_numpy(values).nbytes for values in self._model.parameters)

    @property
    def facts(self) -> Mapping[str, float | str]:
        """Size, steps, parameters, and the error on held-out points in units of the mean target."""
        return {
            **self._facts,
            "size": self._size,
            "parameters": self.storage_bytes // 4,
        }

    def render(self, view: View, seed: int) -> np.ndarray:
        """A view's radiance, (H, W, 3), with the camera walks of the field's rendering."""
        width, height = self._task.size
        spp, sampler = self._settings.spp, self._settings.sampler
        sensor = make_sensor(view, width, height, sampler=sampler)
        return render_in_batches(self._task.scene, self._integrator, sensor, spp, seed)[..., :3]

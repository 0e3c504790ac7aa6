"""Photon mapping with few passes, by this project's own SPPM, which also makes the references."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields

import mitsuba as mi
import numpy as np

from baselines.options import SppmOptions
from baselines.protocol import CannotServe, Task
from baselines.sampling import own_camera
from gpf.camera.film import sample_film
from gpf.core.errors import UserError
from gpf.core.random import Stream, pass_seed
from gpf.core.structs import Photons, to_numpy
from gpf.photons.tracing import PathSettings, record_photons
from gpf.scene.materials import require_separable
from gpf.scene.sensors import make_sensor
from gpf.scene.views import View
from gpf.sppm.passes import propose_radius


class Sppm:
    """Stochastic progressive photon mapping, stopped after a few passes.

    Three things differ from the references. There are few passes. Photons are emitted as the lamps
    emit light, without guiding towards the visible region. The radius of the first pass is chosen
    for the scene's own camera, because there are no training views.
    """

    def __init__(self, options: SppmOptions) -> None:
        self.options = options

    def prepare(self, task: Task) -> PreparedSppm:
        """Measure the radius of the first pass and the memory of its photons.

        Raises
        ------
        CannotServe: the diffuse part of a material cannot be separated, or the scene has no camera
            of its own.
        """
        scene, paths = task.scene, self.options.photons_per_pass
        try:
            require_separable(scene)
        except UserError as error:
            raise CannotServe(
                f"scene {task.name}", f"no photon mapping: {error}", "Leave it out for this scene."
            ) from error
        camera = own_camera(task)
        points = sample_film(scene, camera, pass_seed(task.seed, 0, Stream.CAMERA)).points
        radius = propose_radius(scene, points, PathSettings(paths), seed=task.seed)
        seed = pass_seed(task.seed, 1, Stream.PHOTONS)
        photons = record_photons(scene, PathSettings(paths, rr_depth=task.rr_depth), seed=seed)
        integrator = mi.load_dict(
            {
                "type": "sppm",
                "passes": self.options.passes,
                "photons_per_pass": paths,
                "initial_radius": radius,
                "rr_depth": task.rr_depth,
                "direct": "emitters",
            }
        )
        storage = count_bytes(photons)
        facts: dict[str, float | str] = {
            "passes": self.options.passes,
            "photons_per_pass": paths,
            "initial_radius": radius,
        }
        return PreparedSppm(task, integrator, self.options.passes, storage, facts)


@dataclass(frozen=True)
class PreparedSppm:
    """A scene with the settings of its passes.

    Attributes
    ----------
    storage_bytes: the photons of one pass. A view needs all of them, although every view traces
        its own passes and keeps none.
    """

    task: Task
    integrator: mi.Integrator
    passes: int
    storage_bytes: int
    facts: Mapping[str, float | str]

    def render(self, view: View, seed: int) -> np.ndarray:
        """A view's radiance, W/(m² sr), (H, W, 3) float32, linear."""
        sensor = make_sensor(view, *self.task.size)
        image = mi.render(
            self.task.scene,
            integrator=self.integrator,
            sensor=sensor,
            spp=self.passes,
            seed=pass_seed(seed, 0, Stream.PHOTONS),
        )
        return np.asarray(image.numpy(), dtype=np.float32)


def count_bytes(photons: Photons) -> int:
    """Bytes that photons occupy in memory."""
    return sum(to_numpy(getattr(photons, f.name)).nbytes for f in fields(photons))

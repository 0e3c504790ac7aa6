"""Path tracing with few samples and a denoiser."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass

import mitsuba as mi
import numpy as np

from baselines.denoised.guides import are_noisy, render_guides
from baselines.options import DenoisedOptions
from baselines.path_tracer import make_path_integrator
from baselines.protocol import CannotServe, Task
from baselines.sampling import Samples, own_camera, render_in_batches
from gpf.core.errors import UserError
from gpf.rendering.denoiser import ImageDenoiser
from gpf.rendering.timed_sampling import time_of
from gpf.scene.media import medium_at
from gpf.scene.sensors import make_sensor
from gpf.scene.views import View

# Rays per pixel for the guides, which have little noise.
GUIDE_SPP = 32


class Denoised:
    """Mitsuba's ``path``, then Open Image Denoise with albedo and normals as guides.

    The denoiser removes noise. It cannot add light that no path has found.
    """

    def __init__(self, options: DenoisedOptions) -> None:
        self.options = options

    def prepare(self, task: Task) -> PreparedDenoised:
        """Build the networks; for ``equal_time``, measure the time of guides and denoiser.

        Raises
        ------
        CannotServe: the package is missing; for ``equal_time``, ``task.seconds_per_view`` is None,
            or the guides and the denoiser take longer than that.
        """
        samples = Samples.plan(self.options.spp, task)
        noisy = are_noisy(task.scene)
        try:
            denoiser = ImageDenoiser(task.size, prefilter=noisy, cuda="cuda" in str(mi.variant()))
        except UserError as error:
            raise CannotServe(error.where, error.what, error.todo) from error
        integrator = make_path_integrator(task.scene, task.rr_depth)
        prepared = PreparedDenoised(task, integrator, denoiser, noisy, samples)
        if samples.number is None:
            prepared.take_times()
        return prepared


@dataclass
class PreparedDenoised:
    """A scene, a denoiser, and the number of samples per pixel.

    Attributes
    ----------
    noisy_guides: whether the guides are denoised too.
    samples: samples per pixel; for ``equal_time``, as many as guides and denoiser leave time for.
    denoising_seconds: time of the denoiser per view, for ``equal_time``.
    """

    task: Task
    integrator: mi.Integrator
    denoiser: ImageDenoiser
    noisy_guides: bool
    samples: Samples
    denoising_seconds: float = 0.0

    @property
    def storage_bytes(self) -> int:
        """0: the networks are the same for all scenes."""
        return 0

    @property
    def facts(self) -> Mapping[str, float | str]:
        """``spp``, for ``equal_time`` the mean over the views so far; ``guide_spp``; ``on``: the
        denoiser and its device; ``guides``: whether they are denoised."""
        guides = "prefiltered" if self.noisy_guides else "as they are"
        description = self.denoiser.description
        return {
            "spp": self.samples.spp,
            "guide_spp": GUIDE_SPP,
            "on": description,
            "guides": guides,
        }

    def render(self, view: View, seed: int) -> np.ndarray:
        """A view's radiance, W/(m² sr), (H, W, 3) float32, linear."""
        start = time.perf_counter()
        inside = medium_at(self.task.scene, view.origin)
        sensor = make_sensor(view, *self.task.size, medium=inside)
        guides = render_guides(self.task.scene, sensor, GUIDE_SPP, seed)
        radiance = self.samples.trace(
            lambda spp, seed: self._trace(sensor, spp, seed),
            seed,
            time.perf_counter() - start + self.denoising_seconds,
        )
        return self.denoiser.denoise(radiance, *guides)

    def take_times(self) -> None:
        """Measure the time of guides and denoiser with the scene's own camera.

        This also compiles the kernels.

        Raises
        ------
        CannotServe: they take longer than a view of the field, or the scene has no camera.
        """
        sensor, seed = own_camera(self.task), self.task.seed
        # One sample per pixel needs another kernel than several.
        radiance = self._trace(sensor, 1, seed) + self._trace(sensor, 2, seed)
        guides = render_guides(self.task.scene, sensor, GUIDE_SPP, seed)
        guiding = time_of(lambda: render_guides(self.task.scene, sensor, GUIDE_SPP, seed))
        denoising = time_of(lambda: self.denoiser.denoise(radiance, *guides))
        seconds = self.samples.seconds
        if guiding + denoising >= seconds:
            raise CannotServe(
                f"scene {self.task.name}",
                f"a view of the field takes {seconds:.3g} s, but guides and denoiser take "
                f"{guiding + denoising:.3g} s, so there is no equal time",
                "Give a number of samples.",
            )
        self.denoising_seconds = denoising

    def _trace(self, sensor: mi.Sensor, spp: int, seed: int) -> np.ndarray:
        return render_in_batches(self.task.scene, self.integrator, sensor, spp, seed)

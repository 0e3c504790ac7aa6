"""Path tracing and a denoiser: what somebody would pick who has no time to wait."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass

import mitsuba as mi
import numpy as np

from gpf.baselines.denoised.guides import are_noisy, render_guides
from gpf.baselines.denoised.oidn import ImageDenoiser
from gpf.baselines.options import DenoisedOptions
from gpf.baselines.path_tracer import make_path_integrator
from gpf.baselines.protocol import CannotServe, Task
from gpf.baselines.sampling import own_camera
from gpf.baselines.timed_sampling import Samples, time_of
from gpf.rendering.batches import render_in_batches
from gpf.scene.sensors import make_sensor
from gpf.scene.views import View

# Rays per pixel for the guides, which have little noise.
GUIDE_SPP = 32


class Denoised:
    """Mitsuba's ``path``, and then Open Image Denoise with albedo and normals as guides.

    It removes what noise there is; what no path has found, it cannot know of.
    """

    def __init__(self, options: DenoisedOptions) -> None:
        self.options = options

    def prepare(self, task: Task) -> PreparedDenoised:
        """Build the networks; for ``equal_time``, see what they leave of the time.

        Raises
        ------
        CannotServe: the package is missing, the time of a view from the field is not known, or
            guides and denoiser take it all.
        """
        samples = Samples.plan(self.options.spp, task)
        noisy = are_noisy(task.scene)
        denoiser = ImageDenoiser(task.size, prefilter=noisy, cuda="cuda" in str(mi.variant()))
        integrator = make_path_integrator(task.rr_depth)
        prepared = PreparedDenoised(task, integrator, denoiser, noisy, samples)
        if samples.number is None:
            prepared.take_times()
        return prepared


@dataclass
class PreparedDenoised:
    """A scene, a denoiser, and how many samples pixels get.

    Attributes
    ----------
    noisy_guides: whether the guides are denoised, too.
    samples: how many pixels get; by the clock, as many as the rest leaves time for.
    denoising_seconds: what the denoiser takes of that.
    """

    task: Task
    integrator: mi.Integrator
    denoiser: ImageDenoiser
    noisy_guides: bool
    samples: Samples
    denoising_seconds: float = 0.0

    @property
    def storage_bytes(self) -> int:
        """Nothing is kept but the networks, which are the same for all scenes."""
        return 0

    @property
    def facts(self) -> Mapping[str, float | str]:
        """``spp``, for ``equal_time`` the mean over the views so far; ``guide_spp``; what denoised
        ``on`` what; whether ``guides`` were, too."""
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
        sensor = make_sensor(view, *self.task.size)
        guides = render_guides(self.task.scene, sensor, GUIDE_SPP, seed)
        radiance = self.samples.trace(
            lambda spp, seed: self._trace(sensor, spp, seed),
            seed,
            time.perf_counter() - start + self.denoising_seconds,
        )
        return self.denoiser.denoise(radiance, *guides)

    def take_times(self) -> None:
        """Measure what a view takes beside its samples, with the scene's own camera.

        That compiles the kernels as well.
        """
        sensor, seed = own_camera(self.task), self.task.seed
        # A single sample has a kernel of its own.
        radiance = self._trace(sensor, 1, seed) + self._trace(sensor, 2, seed)
        guides = render_guides(self.task.scene, sensor, GUIDE_SPP, seed)
        guiding = time_of(lambda: render_guides(self.task.scene, sensor, GUIDE_SPP, seed))
        denoising = time_of(lambda: self.denoiser.denoise(radiance, *guides))
        seconds = self.samples.seconds
        if guiding + denoising >= seconds:
            raise CannotServe(
                f"scene {self.task.name}",
                f"a view from the field takes {seconds:.3g} s, guides and denoiser take "
                f"{guiding + denoising:.3g} s, so there is no equal time",
                "Give a number of samples.",
            )
        self.denoising_seconds = denoising

    def _trace(self, sensor: mi.Sensor, spp: int, seed: int) -> np.ndarray:
        return render_in_batches(self.task.scene, self.integrator, sensor, spp, seed)

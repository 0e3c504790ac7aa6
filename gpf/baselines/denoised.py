"""Path tracing and a denoiser: what somebody would pick who has no time to wait."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field

import mitsuba as mi
import numpy as np

from gpf.baselines.denoising_guides import are_noisy, render_guides
from gpf.baselines.image_denoiser import ImageDenoiser
from gpf.baselines.options import DenoisedOptions
from gpf.baselines.path_tracer import make_path_integrator
from gpf.baselines.protocol import CannotServe, Task
from gpf.baselines.sampling import own_camera, render_radiance
from gpf.baselines.timed_sampling import sample_for, time_of
from gpf.seeds import pass_seed
from gpf.sensors import make_sensor
from gpf.views import View

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
        timed = self.options.spp == "equal_time"
        if timed and task.seconds_per_view is None:
            raise CannotServe(
                f"scene {task.name}",
                "what a view from the field costs is not known, so there is no equal time",
                f"Run `gpf stage render --scene {task.name}` first, or give a number of samples.",
            )
        noisy = are_noisy(task.scene)
        denoiser = ImageDenoiser(task.size, prefilter=noisy, cuda="cuda" in str(mi.variant()))
        integrator = make_path_integrator(task.rr_depth)
        if not timed:
            return PreparedDenoised(task, integrator, denoiser, noisy, int(self.options.spp))
        prepared = PreparedDenoised(task, integrator, denoiser, noisy, None)
        prepared.take_times(float(task.seconds_per_view or 0))
        return prepared


@dataclass
class PreparedDenoised:
    """A scene, a denoiser, and how many samples pixels get.

    Attributes
    ----------
    noisy_guides: whether the guides are denoised, too.
    spp: samples per pixel; None for as many as fit into ``seconds`` of a view, less what the rest
        takes. The clock decides, so that their number is not the same each time.
    denoising_seconds: what the denoiser takes of that.
    taken: samples per pixel of the views so far.
    """

    task: Task
    integrator: mi.Integrator
    denoiser: ImageDenoiser
    noisy_guides: bool
    spp: int | None
    seconds: float = 0.0
    denoising_seconds: float = 0.0
    taken: list[int] = field(default_factory=list)

    @property
    def storage_bytes(self) -> int:
        """Nothing is kept but the networks, which are the same for all scenes."""
        return 0

    @property
    def facts(self) -> Mapping[str, float | str]:
        """``spp``, for ``equal_time`` the mean over the views so far; ``guide_spp``; what denoised
        ``on`` what; whether ``guides`` were, too."""
        spp = self.spp if self.spp is not None else float(np.mean(self.taken or [0]))
        guides = "prefiltered" if self.noisy_guides else "as they are"
        description = self.denoiser.description
        return {"spp": spp, "guide_spp": GUIDE_SPP, "on": description, "guides": guides}

    def render(self, view: View, seed: int) -> np.ndarray:
        """A view's radiance, W/(m² sr), (H, W, 3) float32, linear."""
        start = time.perf_counter()
        sensor = make_sensor(view, *self.task.size)
        guides = render_guides(self.task.scene, sensor, GUIDE_SPP, seed)
        if self.spp is not None:
            radiance = self._trace(sensor, self.spp, seed)
        else:
            left = self.seconds - self.denoising_seconds - (time.perf_counter() - start)
            radiance, spp = sample_for(
                left, lambda spp, part: self._trace(sensor, spp, pass_seed(seed, part, stream=2))
            )
            self.taken.append(spp)
        return self.denoiser.denoise(radiance, *guides)

    def take_times(self, seconds: float) -> None:
        """Take so many seconds for a view from now on.

        What a view takes beside its samples is measured with the scene's own camera; that compiles
        the kernels as well.
        """
        sensor, seed = own_camera(self.task), self.task.seed
        # A single sample has a kernel of its own.
        radiance = self._trace(sensor, 1, seed) + self._trace(sensor, 2, seed)
        guides = render_guides(self.task.scene, sensor, GUIDE_SPP, seed)
        guiding = time_of(lambda: render_guides(self.task.scene, sensor, GUIDE_SPP, seed))
        denoising = time_of(lambda: self.denoiser.denoise(radiance, *guides))
        if guiding + denoising >= seconds:
            raise CannotServe(
                f"scene {self.task.name}",
                f"a view from the field takes {seconds:.3g} s, guides and denoiser take "
                f"{guiding + denoising:.3g} s, so there is no equal time",
                "Give a number of samples.",
            )
        self.seconds, self.denoising_seconds = seconds, denoising

    def _trace(self, sensor: mi.Sensor, spp: int, seed: int) -> np.ndarray:
        return render_radiance(self.task.scene, self.integrator, sensor, spp, seed)

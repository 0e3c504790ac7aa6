"""``<integrator type="gpf">``: renders from a fitted Gaussian photon field."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, get_args

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.camera.rays import keeps_to_pixels, sample_pixel_rays, sample_tiled_rays
from gpf.core.loops import loops_traced_once
from gpf.core.random import Stream, pass_seed
from gpf.core.structs import from_numpy
from gpf.field.io import load_field
from gpf.rendering.adaptive import MIN_SPP, sample_adaptively
from gpf.rendering.aovs import (
    at_first_surface,
    channel_names,
    channels,
    parse_aovs,
    split_layers,
)
from gpf.rendering.batches import mean_of_batches
from gpf.rendering.correction import corrected
from gpf.rendering.denoiser import GUIDES, ImageDenoiser, denoise
from gpf.rendering.derivatives import DifferentiableField, attached_radiance
from gpf.rendering.gathered_halves import halves_to_correct, sample_halves
from gpf.rendering.lights import mixed
from gpf.rendering.properties import read_depths
from gpf.rendering.recording import KnownScene, RecordedFrames
from gpf.rendering.sample_sets import largest_launch
from gpf.rendering.scene_check import SceneCheck
from gpf.rendering.settings import Gather
from gpf.rendering.walks import GatheredWalks, GroupedWalks, Walks


class GPF(DifferentiableField):
    r"""Gaussian photon field: one camera walk and one neighbourhood query per sample.

    .. pluginparameters::

     * - field
       - |string|
       - Path of a ``field.safetensors``, relative to the scene file or to the current folder.
         Python code may assign a :class:`gpf.field.field.GaussianPhotonField` to the attribute
         ``field`` instead.
     * - max_depth
       - |int|
       - Longest camera walk in edges; -1 for no limit. The light that the field stores is not
         limited. (Default: -1)
     * - rr_depth
       - |int|
       - Bounces before Russian roulette starts. (Default: 5)
     * - aovs
       - |string|
       - Further channels, as a comma-separated list such as ``depth, albedo``: ``depth``,
         ``position`` and ``normal`` of the first surface; ``albedo``, ``visible_normal``,
         ``irradiance``, ``coverage`` and ``error`` of the visible point
         (:mod:`gpf.rendering.aovs`). (Default: none)
     * - adaptive
       - |bool|
       - Give more samples to noisy pixels, behind glass and along edges, and fewer to others;
         the mean number is as requested. Needs a box filter and at least 16 samples per pixel.
         (Default: false)
     * - suppress_fireflies
       - |bool|
       - With adaptive sampling, give less weight to single samples of very high radiance that no
         nearby sample confirms. Images lose a little energy. (Default: false)
     * - denoise
       - |bool|
       - Denoise the image with Open Image Denoise (package ``pyoidn``), with the albedo and the
         normals of visible points as guides. With adaptive sampling, it changes only what
         noise explains. (Default: false)
     * - gather
       - |string|
       - ``always``: what lamps and other diffuse surfaces send to a visible point comes from
         samples of the lamps and from rays that end in the field; only caustics are the field's
         answer there. Images have more noise, but no blotches and no light that leaks through
         walls. ``auto``: with a denoiser, a box filter and at least 8 samples per pixel, as many
         such samples correct the field's image where two halves of them show the same
         (:mod:`gpf.rendering.correction`). ``never``: only the field. Not for derivatives or
         recorded frames. (Default: auto)
     * - lights
       - |string|
       - Levels of groups of emitters, such as ``window=0.2, lamp=1.5, #ffd0a0``: a factor, and a
         colour (sRGB) for the group before it. Needs a field that keeps groups apart.
         (Default: none)
     * - record
       - |bool|
       - Record the first frames and replay them with other seeds, cameras and fields. This is
         for viewers and animations, where tracing the Python code for each frame takes more
         than a third of the time. Some Mitsuba plugins and adaptive sampling cannot be recorded.
         (Default: false)

    Camera rays follow glossy and specular bounces and end at the first diffuse hit, where the
    field gives the irradiance. Direct light that the field does not store is added there from a
    sample of the emitters. A warning is given if geometry, materials or lights differ from those
    of the scene for which the field was made.

    Derivatives: see :mod:`gpf.rendering.derivatives`. Not supported: polarisation, and spectral
    variants.

    .. code-block:: xml

        <integrator type="gpf">
            <string name="field" value="field.safetensors"/>
        </integrator>
    """

    def __init__(self, props: mi.Properties) -> None:
        self.depth_limit = read_depths(props, "gpf")
        path = props.get("field", "")
        self.aovs = parse_aovs(props.get("aovs", ""))
        self.adaptive = props.get("adaptive", False)
        self.suppress_fireflies = props.get("suppress_fireflies", False)
        self.denoise = props.get("denoise", False)
        self.gather = props.get("gather", "auto")
        if self.gather not in get_args(Gather):
            raise ValueError(f"gather is {self.gather!r}; use one of {', '.join(get_args(Gather))}")
        self.lights = props.get("lights", "")
        self.levels: dict[str, mi.Color3f] = {}
        self.record = props.get("record", False)
        super().__init__(props)
        self._guides: tuple[str, ...] = ()  # AOVs of a sample that only the denoiser asks for
        self._denoiser: ImageDenoiser | None = None
        self._check, self._known = SceneCheck(), KnownScene()
        self.recorded_frames = RecordedFrames()
        found = mi.file_resolver().resolve(path) if path else ""
        self.field: Any = load_field(Path(str(found))) if path else None

    def render(
        self,
        scene: mi.Scene,
        sensor: Any = 0,
        seed: Any = 0,
        spp: int = 0,
        develop: bool = True,
        evaluate: bool = True,
    ) -> Any:
        """Render an image; parameters as for every Mitsuba integrator."""
        if isinstance(sensor, int):
            sensor = scene.sensors()[sensor]
        image, variance = self.sample_image(scene, sensor, seed, spp, develop, evaluate)
        if not (self.denoise and develop):
            return image
        number = plain_seed(seed)
        spp = spp or sensor.sampler().sample_count()
        gather = partial(self.gathered_for, scene, sensor, number, spp)
        correct = gather if self.corrects(sensor) else None
        return from_numpy(mi.TensorXf, self.denoised(np.array(image), variance, correct))

    def corrects(self, sensor: mi.Sensor) -> bool:
        """Whether denoised images of a sensor are corrected by gathered light, whose images have a
        box filter."""
        knows = getattr(self.field, "caustics", None) is not None and not self.wanted_levels()
        box = bool(sensor.film().rfilter().is_box_filter())
        return self.gather == "auto" and self.denoise and knows and box

    def gathered_for(
        self,
        scene: mi.Scene,
        sensor: mi.Sensor,
        seed: int,
        spp: int,
        picture: np.ndarray,
        seconds: float | None = None,
    ) -> np.ndarray | None:
        """Two images that correct a picture from the field, or None:
        :func:`gpf.rendering.gathered_halves.halves_to_correct`."""
        self._known.prepare(scene)
        walks = GatheredWalks(self._walks(scene, ()), self._known.steps)

        def look(sampler: mi.Sampler, ray: mi.Ray3f) -> mi.Color3f:
            return self._look(walks, sampler, ray, mi.Bool(True))["radiance"]

        def gather(spp: int, part: int) -> np.ndarray:
            own = pass_seed(seed, part, Stream.GATHERED_HALVES)
            return sample_halves(look, sensor, own, spp)

        return halves_to_correct(picture, spp, gather, seconds)

    def sample_image(
        self,
        scene: mi.Scene,
        sensor: mi.Sensor,
        seed: Any,
        spp: int,
        develop: bool = True,
        evaluate: bool = True,
    ) -> tuple[Any, np.ndarray | None]:
        """What :meth:`render` denoises: an image with the channels that the denoiser needs, and
        the variance of its pixels, (H, W), where that is known; parameters as there."""
        if self.field is None:
            return super().render(scene, sensor, seed, spp, develop, evaluate), None
        self._check.compare(scene, self.field)
        self._known.prepare(scene)
        with mixed(scene, self.field, self.wanted_levels()):
            if not develop:
                return super().render(scene, sensor, seed, spp, develop, evaluate), None
            self._guides = self._further_guides()
            try:
                return self._sample_image(scene, sensor, seed, spp, evaluate)
            finally:
                self._guides = ()

    def _further_guides(self) -> tuple[str, ...]:
        return tuple(name for name in GUIDES if self.denoise and name not in self.aovs)

    def _sample_image(
        self, scene: mi.Scene, sensor: mi.Sensor, seed: Any, spp: int, evaluate: bool
    ) -> tuple[mi.TensorXf, np.ndarray | None]:
        """The mean of all samples, and the variance of its pixels where that is known."""
        spp = spp or sensor.sampler().sample_count()
        if self.adaptive and spp >= MIN_SPP:
            if not keeps_to_pixels(sensor):
                raise RuntimeError(
                    "Adaptive sampling needs a film with a box filter and a shutter time of zero. "
                    'Add <rfilter type="box"/> to the film, or set "adaptive" to false.'
                )
            return self._sample_adaptively(scene, sensor, seed, spp)
        if self.record:
            facts = self.aovs, self._guides, self.field.settings, self._known.changes
            fields = self.field.arrays()
            return self.recorded_frames.render(
                self._sample_with, scene, sensor, seed, spp, fields, facts
            ), None
        return self._sample_evenly(scene, sensor, seed, spp, evaluate), None

    def _sample_evenly(
        self, scene: mi.Scene, sensor: mi.Sensor, seed: Any, spp: int, evaluate: bool = True
    ) -> mi.TensorXf:
        """The mean of all samples, as many in each pixel."""
        pixels, most = math.prod(sensor.film().crop_size()), largest_launch()
        if spp * pixels <= most:
            return super().render(scene, sensor, seed, spp, True, evaluate)

        def batch(spp: int, seed: int) -> np.ndarray:
            return np.array(super(GPF, self).render(scene, sensor, seed, spp))

        image = mean_of_batches(batch, spp, plain_seed(seed), pixels, most)
        return from_numpy(mi.TensorXf, image)

    def _sample_with(
        self, scene: mi.Scene, sensor: mi.Sensor, seed: mi.UInt32, spp: int, arrays: Any
    ) -> Any:
        """The mean of all samples, with other arrays of the field."""
        field = self.field
        self.field = field.with_arrays(arrays)
        try:
            return super().render(scene, sensor, seed, spp)
        finally:
            self.field = field

    def _sample_adaptively(
        self, scene: mi.Scene, sensor: mi.Sensor, seed: Any, spp: int
    ) -> tuple[mi.TensorXf, np.ndarray | None]:
        film = sensor.film()
        has_alpha = mi.has_flag(film.flags(), mi.FilmFlags.Alpha)

        def sample(sampler: mi.Sampler, pixel: mi.Vector2u) -> list[mi.Float]:
            ray, weight = sample_pixel_rays(sensor, sampler, pixel)
            walks = self._sharing_walks(scene)
            found = self._look(walks, sampler, ray, mi.Bool(True))
            alpha = [dr.select(found["valid"], mi.Float(1), 0)] if has_alpha else []
            radiance = found["radiance"] * weight
            return [*radiance, *alpha, mi.Float(1), *channels(walks.aovs, found)]

        film.prepare(self.aov_names())
        size = int(film.crop_size()[0]), int(film.crop_size()[1])
        switches = self.suppress_fireflies, self.denoise
        variance = None
        with dr.suspend_grad():
            means = sample_adaptively(
                sample, sensor.sampler(), size, spp, plain_seed(seed), *switches
            )
            if self.denoise:
                variance = means[..., -1].numpy()
                means = means[..., :-1]
            offset = mi.ScalarPoint2i(film.crop_offset())
            film.put_block(mi.ImageBlock(means, offset, border=False))
            return film.develop(), variance

    def denoised(
        self,
        image: np.ndarray,
        variance: np.ndarray | None,
        gather: Callable[[np.ndarray], np.ndarray | None] | None = None,
    ) -> np.ndarray:
        """The image without noise, and without the channels that only the denoiser asks for; from
        :meth:`sample_image`, or the mean of several such images. ``gather`` is called with the
        radiance without noise; it returns two images that correct it, or None."""
        size = image.shape[1], image.shape[0]
        if self._denoiser is None or self._denoiser.size != size:
            cuda = "cuda" in str(mi.variant())
            self._denoiser = ImageDenoiser(size, prefilter=True, cuda=cuda, quality="balanced")
        names = (*self.aovs, *self._further_guides())
        first = image.shape[2] - len(channel_names(names))
        layers = split_layers(np.concatenate([image[..., :3], image[..., first:]], axis=2), names)
        guides = layers[GUIDES[0]], layers[GUIDES[1]]
        if self.gather == "always":
            variance = None  # so few of the samples are bright that it is often underestimated
        clean = denoise(layers["radiance"], guides, variance, self._denoiser)
        if gather is not None and (halves := gather(clean)) is not None:
            clean = corrected(clean, halves, guides[1], self._denoiser)
        end = first + len(channel_names(self.aovs))
        return np.concatenate([clean, image[..., 3:end]], axis=2)

    def sample(  # type: ignore[no-untyped-def]
        self, mode, scene, sampler, ray, depth=None, active=True, **kwargs
    ) -> tuple[Any, ...]:
        """Radiance of camera rays, (N, 3), whether they end on a diffuse surface, (N,), and the
        channels of the AOVs, (N,) each."""
        ray, active = mi.Ray3f(ray), mi.Bool(active)
        if mode != dr.ADMode.Primal:
            radiance, valid = attached_radiance(self._walks(scene), sampler, ray, active)
            return radiance, valid, [mi.Float(0) for _ in self.aov_names()], None
        # Recorded frames are one kernel.
        walks = self._walks(scene) if self.record else self._sharing_walks(scene)
        found = self._look(walks, sampler, ray, active)
        return found["radiance"], found["valid"], channels(walks.aovs, found), None

    def _walks(self, scene: mi.Scene, aovs: tuple[str, ...] | None = None) -> Walks:
        """The walks that follow the samples of a scene, by default with all AOVs."""
        if self.field is None:
            raise RuntimeError(
                'The gpf integrator has no field: set its "field" property to the path of a '
                "field.safetensors, or assign a GaussianPhotonField to its attribute field."
            )
        aovs = (*self.aovs, *self._guides) if aovs is None else aovs
        divides = self._known.divides(scene)
        return Walks(scene, self.field, aovs, self.depth_limit, self.rr_depth, divides)

    def _sharing_walks(self, scene: mi.Scene) -> GroupedWalks:
        """The walks of many samples."""
        kind = GatheredWalks if self.gather == "always" else GroupedWalks
        return kind(self._walks(scene), self._known.steps)

    @loops_traced_once
    def _look(
        self, walks: Walks, sampler: mi.Sampler, ray: mi.Ray3f, active: mi.Bool
    ) -> dict[str, Any]:
        """What rays find, with all AOVs."""
        found = walks.look(sampler, ray, active)
        return found | at_first_surface(walks.scene, ray, walks.aovs, active)

    def sample_rays(
        self, scene: mi.Scene, sensor: mi.Sensor, sampler: mi.Sampler
    ) -> tuple[Any, ...]:
        """Camera rays, in small tiles of pixels."""
        return sample_tiled_rays(scene, sensor, sampler)

    def aov_names(self) -> list[str]:
        """The names of the channels besides radiance."""
        return channel_names((*self.aovs, *self._guides))

    def to_string(self) -> str:
        """A description, for print."""
        return f"GPF[field={self.field}, max_depth={self.depth_limit}]"


def plain_seed(seed: Any) -> int:
    """A seed as Python's number."""
    return seed if isinstance(seed, int) else int(dr.slice(seed))


mi.register_integrator("gpf", GPF)

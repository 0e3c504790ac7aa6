"""``<integrator type="gpf">``: renders from a fitted Gaussian photon field."""

from __future__ import annotations

import operator
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.camera.film import meets_gloss
from gpf.camera.rays import keeps_to_pixels, sample_pixel_rays, sample_tiled_rays
from gpf.camera.visible_points import Side, follow
from gpf.core.structs import from_numpy
from gpf.field.io import load_field
from gpf.rendering.adaptive import MIN_SPP, sample_adaptively
from gpf.rendering.aovs import (
    at_first_surface,
    at_visible_point,
    channel_names,
    channels,
    parse_aovs,
    split_layers,
)
from gpf.rendering.denoiser import GUIDES, ImageDenoiser
from gpf.rendering.lights import mixed
from gpf.rendering.properties import read_depths, whole_number
from gpf.rendering.recording import Recording
from gpf.rendering.scene_check import warn_of_another_scene
from gpf.scene.inventory import divides_glass
from gpf.scene.materials import has_gloss, require_separable

# How the values of further walks join those of the first; all others are added.
_JOIN = {"valid": operator.or_, "coverage": dr.maximum}


def _join(found: dict[str, Any], further: dict[str, Any]) -> dict[str, Any]:
    return {key: _JOIN.get(key, operator.add)(found[key], further[key]) for key in found}


def _add(found: dict[str, Any], further: dict[str, Any], share: mi.Float) -> dict[str, Any]:
    """The sum of two parts; ``valid`` is that of the first if its share is at least a half."""
    valid = dr.select(share >= 0.5, found["valid"], further["valid"])
    return {key: valid if key == "valid" else v + further[key] for key, v in found.items()}


def _mean(found: dict[str, Any], walks: mi.UInt32) -> dict[str, Any]:
    number = mi.Float(walks)
    return {key: value if key in _JOIN else value / number for key, value in found.items()}


class GPF(mi.ad.integrators.common.ADIntegrator):
    r"""Gaussian photon field: one camera walk and one neighbourhood query per sample.

    .. pluginparameters::

     * - field
       - |string|
       - Path of a ``field.safetensors``, relative to the scene file or to the current folder.
         Python code may assign a :class:`gpf.field.field.GaussianPhotonField` to the attribute
         ``field`` instead.
     * - max_depth
       - |int|
       - Longest camera walk in edges; -1 is no limit. The light that the field stores is not
         limited. (Default: -1)
     * - rr_depth
       - |int|
       - Bounces before Russian roulette starts. (Default: 5)
     * - glossy_walks
       - |int|
       - Number of camera walks of a sample that meets a glossy surface first, because the
         surface may reflect in many directions. (Default: 4)
     * - aovs
       - |string|
       - Further channels, a list of names with commas, such as ``depth, albedo``. They are
         ``depth``, ``position`` and ``normal`` of the first surface; ``albedo``,
         ``visible_normal``, ``irradiance``, ``coverage`` and ``error`` of the visible point
         (:mod:`gpf.rendering.aovs`). (Default: none)
     * - adaptive
       - |bool|
       - Give more samples to noisy pixels, behind glass and along edges, and fewer to others;
         the mean number is as requested. Needs a box filter and at least 16 samples per pixel.
         (Default: false)
     * - suppress_fireflies
       - |bool|
       - With adaptive samples: single samples of great radiance that no nearby sample confirms
         count less. Images lose a little energy. (Default: false)
     * - denoise
       - |bool|
       - Denoise the image with Open Image Denoise (package ``pyoidn``), with the albedo and the
         normals of visible points as guides. Pays for images with few samples: up to 16 per pixel
         where there is glass or water. (Default: false)
     * - lights
       - |string|
       - Levels of groups of emitters, such as ``window=0.2, lamp=1.5, #ffd0a0``: a factor, and a
         colour (sRGB) for the group before it. Needs a field that keeps groups apart.
         (Default: none)
     * - record
       - |bool|
       - Record the first frames and replay them with other seeds, cameras and fields. This is
         for viewers and animations, where tracing the Python code for each frame takes more
         than a third of the time. Some plugins of Mitsuba, and adaptive samples, cannot be
         recorded. (Default: false)

    Camera rays follow glossy and specular bounces and end at the first diffuse hit, where the
    field gives the irradiance. Direct light that the field does not store is added there from a
    sample of the emitters. A warning is given if the scene's bounding box differs from
    that of the scene for which the field was made.

    Not supported: participating media, polarisation, derivatives, and spectral variants.

    .. code-block:: xml

        <integrator type="gpf">
            <string name="field" value="field.safetensors"/>
        </integrator>
    """

    def __init__(self, props: mi.Properties) -> None:
        self.depth_limit = read_depths(props, "gpf")
        path = props.get("field", "")
        self.glossy_walks = whole_number(props.get("glossy_walks", 4), "glossy_walks", 1)
        self.aovs = parse_aovs(props.get("aovs", ""))
        self.adaptive = props.get("adaptive", False)
        self.suppress_fireflies = props.get("suppress_fireflies", False)
        self.denoise = props.get("denoise", False)
        self.lights = props.get("lights", "")
        self._denoiser: tuple[tuple[int, int], ImageDenoiser] | None = None
        super().__init__(props)
        # Shapes of the last checked scene, held so that their ids are not reused. Not the scene: it
        # may hold this integrator, and circular references are never freed.
        self._checked: list[mi.Shape] | None = None
        self._compared: Any = None
        self._walks, self._divides = 1, False
        self.record = props.get("record", False)
        self.recording: Recording | None = None
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
        self._compare(scene)
        if self.lights and self.field is not None:
            levels, self.lights = self.lights, ""
            try:
                with mixed(scene, self.field, levels):
                    return self.render(scene, sensor, seed, spp, develop, evaluate)
            finally:
                self.lights = levels
        if self.denoise and develop:
            return self._render_denoised(scene, sensor, seed, spp)
        if self.adaptive and develop and (spp or sensor.sampler().sample_count()) >= MIN_SPP:
            if not keeps_to_pixels(sensor):
                raise RuntimeError(
                    "Adaptive samples need a film with a box filter and a shutter time of zero. "
                    'Add <rfilter type="box"/> to the film, or set "adaptive" to false.'
                )
            return self._render_adaptively(scene, sensor, seed, spp)
        if not self.record or self.field is None or not develop:
            return super().render(scene, sensor, seed, spp, develop, evaluate)
        size = tuple(int(v) for v in sensor.film().crop_size())
        facts = (size, spp, self.aovs, self.field.settings)
        if self.recording is None or not self.recording.serves(scene, sensor, facts):
            self.recording = Recording(scene, sensor, facts, self._render_with)
        return self.recording.frame(mi.UInt32(seed), spp, self.field.arrays())

    def _render_adaptively(
        self, scene: mi.Scene, sensor: mi.Sensor, seed: Any, spp: int
    ) -> mi.TensorXf:
        film = sensor.film()
        has_alpha = mi.has_flag(film.flags(), mi.FilmFlags.Alpha)

        def sample(sampler: mi.Sampler, pixel: mi.Vector2u) -> list[mi.Float]:
            ray, weight = sample_pixel_rays(sensor, sampler, pixel)
            radiance, valid, aovs, _ = self.sample(dr.ADMode.Primal, scene, sampler, ray)
            alpha = [dr.select(valid, mi.Float(1), 0)] if has_alpha else []
            return [*(radiance * weight), *alpha, mi.Float(1), *aovs]

        film.prepare(self.aov_names())
        size = int(film.crop_size()[0]), int(film.crop_size()[1])
        sampler, spp = sensor.sampler(), spp or sensor.sampler().sample_count()
        seed = int(dr.slice(seed)) if not isinstance(seed, int) else seed
        with dr.suspend_grad():
            means = sample_adaptively(sample, sampler, size, spp, seed, self.suppress_fireflies)
            offset = mi.ScalarPoint2i(film.crop_offset())
            film.put_block(mi.ImageBlock(means, offset, border=False))
            return film.develop()

    def _render_denoised(
        self, scene: mi.Scene, sensor: mi.Sensor, seed: Any, spp: int
    ) -> mi.TensorXf:
        size = int(sensor.film().crop_size()[0]), int(sensor.film().crop_size()[1])
        if self._denoiser is None or self._denoiser[0] != size:
            cuda = "cuda" in str(mi.variant())
            denoiser = ImageDenoiser(size, prefilter=True, cuda=cuda, quality="balanced")
            self._denoiser = size, denoiser
        wanted = self.aovs
        self.aovs = (*wanted, *(name for name in GUIDES if name not in wanted))
        self.denoise = False
        try:
            image = np.array(self.render(scene, sensor, seed, spp))
            first = image.shape[2] - len(self.aov_names())
            together = np.concatenate([image[..., :3], image[..., first:]], axis=2)
            layers = split_layers(together, self.aovs)
        finally:
            self.aovs, self.denoise = wanted, True
        guides = (layers[name] for name in GUIDES)
        image[..., :3] = self._denoiser[1].denoise(layers["radiance"], *guides)
        return from_numpy(mi.TensorXf, image[..., : first + len(self.aov_names())])

    def _compare(self, scene: mi.Scene) -> None:
        """Warn, once for each pair of scene and field, if they do not belong together."""
        if self.field is not None:
            bounds = [[float(v) for v in corner] for corner in self.field.bounds]
            if self._compared != (scene.shapes(), bounds):
                self._compared = scene.shapes(), bounds
                warn_of_another_scene(scene, bounds)

    def _render_with(
        self, scene: mi.Scene, sensor: mi.Sensor, seed: mi.UInt32, spp: int, arrays: Any
    ) -> Any:
        field = self.field
        self.field = field.with_arrays(arrays)
        try:
            return super().render(scene, sensor, seed, spp)
        finally:
            self.field = field

    def sample(  # type: ignore[no-untyped-def]
        self, mode, scene, sampler, ray, depth=None, active=True, **kwargs
    ) -> tuple[Any, ...]:
        """Radiance of camera rays, (N, 3), whether they end on a diffuse surface, (N,), and the
        channels of the AOVs, (N,) each."""
        if mode != dr.ADMode.Primal:
            raise RuntimeError("The gpf integrator has no derivatives.")
        if self.field is None:
            raise RuntimeError(
                'The gpf integrator has no field: set its "field" property to the path of a '
                "field.safetensors, or assign a GaussianPhotonField to its attribute field."
            )
        if self._checked != scene.shapes():
            require_separable(scene)
            self._walks = self.glossy_walks if has_gloss(scene) else 1
            self._divides = divides_glass(scene)
            self._checked = scene.shapes()
        ray = mi.Ray3f(ray)
        found, share = self._walk(
            scene, sampler, ray, active, "through" if self._divides else "either"
        )
        if self._divides:
            divided = mi.Bool(active) & (share < 1)
            found = self._walk_back(scene, sampler, ray, divided, share, found)
        if self._walks > 1:
            found = self._walk_again(scene, sampler, ray, active, found)
        found |= at_first_surface(scene, ray, self.aovs, mi.Bool(active))
        return found["radiance"], found["valid"], channels(self.aovs, found), None

    def _walk(
        self,
        scene: mi.Scene,
        sampler: mi.Sampler,
        ray: mi.Ray3f,
        active: mi.Bool | bool,
        side: Side = "either",
    ) -> tuple[dict[str, Any], mi.Float]:
        """What one camera walk finds: ``radiance``, (N, 3), whether it ends on a diffuse surface,
        ``valid``, (N,), and the AOVs of its visible point; and the weight of its side, (N,)."""
        lamps = self.field.settings.sampled_lamps(scene)
        points, share = follow(
            scene, sampler, ray, self.depth_limit, self.rr_depth, active, lamps, side
        )
        value, reach = self.field.query(points.p, points.n, points.valid)
        found = {"radiance": self.field.reflect(points, value), "valid": points.valid}
        found |= at_visible_point(self.field, points, value, reach, share, self.aovs)
        return found, share

    @dr.syntax
    def _walk_back(self, scene, sampler, ray, active, share, found):  # type: ignore[no-untyped-def]
        """The sum of what was found through smooth glass and what it reflects."""
        if active:
            further, _ = self._walk(scene, sampler, ray, active, "back")
            found = _add(found, further, share)
        return found

    @dr.syntax
    def _walk_again(self, scene, sampler, ray, active, found):  # type: ignore[no-untyped-def]
        """The mean over several walks for rays whose first surface is glossy; of ``coverage``, the
        largest value."""
        again = meets_gloss(scene, ray, mi.Bool(active))
        walks = dr.opaque(mi.UInt32, self._walks)
        n = mi.UInt32(1)
        while again & (n < walks):
            further, _ = self._walk(scene, sampler, ray, again)
            found = _join(found, further)
            n += 1
        return _mean(found, n)

    def sample_rays(
        self, scene: mi.Scene, sensor: mi.Sensor, sampler: mi.Sampler
    ) -> tuple[Any, ...]:
        """Camera rays, in small tiles of pixels."""
        return sample_tiled_rays(scene, sensor, sampler)

    def aov_names(self) -> list[str]:
        """The names of the channels beside radiance."""
        return channel_names(self.aovs)

    def to_string(self) -> str:
        """A description, for print."""
        return f"GPF[field={self.field}, max_depth={self.depth_limit}]"


mi.register_integrator("gpf", GPF)

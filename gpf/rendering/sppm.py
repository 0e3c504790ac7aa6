"""``<integrator type="sppm">``: stochastic progressive photon mapping."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import drjit as dr
import mitsuba as mi

from gpf.camera.film import FilmSamples, reconstruct, sample_film, sample_grid
from gpf.core.random import Stream, pass_seed
from gpf.core.structs import concatenate
from gpf.photons.tracing import PathSettings
from gpf.rendering.properties import is_number, read_depths, whole_number
from gpf.scene.lamps import Lamps
from gpf.scene.materials import require_separable
from gpf.sppm.passes import PassSettings, PhotonPasses, propose_radius

# Largest number of visible points in memory, about 300 bytes each. Larger films are rendered in
# bands of rows.
MOST_POINTS = 1 << 20


def split_rows(film: mi.Film) -> Iterator[range]:
    """The rows of a film's sample grid, in bands of at most :data:`MOST_POINTS` samples."""
    width, height = sample_grid(film)
    rows = max(1, MOST_POINTS // width)
    for first in range(0, height, rows):
        yield range(first, min(first + rows, height))


class SPPM(mi.ad.integrators.common.ADIntegrator):
    r"""Stochastic progressive photon mapping (Hachisuka and Jensen 2009).

    .. pluginparameters::

     * - passes
       - |int|
       - Passes to average, each with one sample per pixel. The ``spp`` argument of
         ``mi.render`` takes precedence. (Default: 64)
     * - photons_per_pass
       - |int|
       - Photon paths emitted in each pass. (Default: 100000)
     * - initial_radius
       - |float|
       - Kernel radius of the first pass in world units; 0 derives it from the photon density
         that a pilot pass measures. (Default: 0)
     * - alpha
       - |float|
       - Radius reduction, in (0, 1): radii shrink by
         :math:`r_{t+1} = r_t \sqrt{(t + \alpha) / (t + 1)}`. (Default: 0.7)
     * - max_depth
       - |int|
       - Longest path in edges, as in ``path``; -1 for no limit. (Default: -1)
     * - rr_depth
       - |int|
       - Interactions before Russian roulette starts. (Default: 5)
     * - glossy_walks
       - |int|
       - Number of camera walks for a sample whose first surface is glossy, because the surface
         may reflect in many directions. (Default: 8)
     * - edge_correction
       - |bool|
       - Whether to correct for the part of the kernel's disc beyond the edge of a surface, where
         no photon can land. Without the correction, edges have dark lines that fade as the
         radius shrinks. (Default: true)
     * - direct
       - |string|
       - Source of direct light: ``photons``, like all other light, or a sample of the
         ``emitters`` at each visible point, which gives less noise and sharp shadows. Photons
         always carry caustics; they carry all light if an emitter cannot be sampled
         (``directionalarea``). (Default: photons)

    Camera rays follow glossy and specular bounces and end at the first diffuse hit. The
    estimate is consistent: its bias vanishes as the radius shrinks with the number of passes.
    The same seed gives the same image, bit for bit, on any number of threads.

    In media, camera rays also look up the photons in a ball around a random place on their way.

    Not supported: polarisation, derivatives, and spectral variants.

    .. code-block:: xml

        <integrator type="sppm">
            <integer name="passes" value="256"/>
            <integer name="photons_per_pass" value="200000"/>
        </integrator>
    """

    def __init__(self, props: mi.Properties) -> None:
        self.depth_limit = read_depths(props, "sppm")
        super().__init__(props)
        self.passes = whole_number(props.get("passes", 64), "passes", 1)
        self.photons_per_pass = whole_number(
            props.get("photons_per_pass", 100_000), "photons_per_pass", 1
        )
        self.initial_radius = props.get("initial_radius", 0.0)
        self.alpha = props.get("alpha", 0.7)
        if not (is_number(self.initial_radius) and 0 <= self.initial_radius < math.inf):
            raise ValueError(
                f'"initial_radius" is {self.initial_radius!r}; give a number of 0 or more.'
            )
        if not (is_number(self.alpha) and 0 < self.alpha < 1):
            raise ValueError(f'"alpha" is {self.alpha!r}; give a number between 0 and 1.')
        self.glossy_walks = whole_number(props.get("glossy_walks", 8), "glossy_walks", 1)
        self.edge_correction = bool(props.get("edge_correction", True))
        self.direct = props.get("direct", "photons")
        if self.direct not in ("photons", "emitters"):
            raise ValueError(f'"direct" is {self.direct!r}; choose "photons" or "emitters".')

    def render(
        self,
        scene: mi.Scene,
        sensor: Any = 0,
        seed: Any = 0,
        spp: int = 0,
        develop: bool = True,
        evaluate: bool = True,
    ) -> Any:
        """Render an image; a positive ``spp`` is the number of passes."""
        if isinstance(sensor, int):
            sensor = scene.sensors()[sensor]
        require_separable(scene)
        seed = int(dr.slice(seed)) if not isinstance(seed, int) else seed
        film = sensor.film()
        film.prepare([])
        with dr.suspend_grad():
            passes = PhotonPasses(scene, self.settings(scene, sensor, seed), seed)
            total: Any = 0
            for t in range(1, (spp or self.passes) + 1):
                total += self._render_pass(sensor, passes, t)
                # One launch per pass limits the memory to that of one pass.
                dr.eval(total)
            offset = mi.ScalarPoint2i(film.crop_offset())
            film.put_block(mi.ImageBlock(total, offset, border=False))
            return film.develop() if develop else None

    def settings(self, scene: mi.Scene, sensor: mi.Sensor, seed: int) -> PassSettings:
        """Settings of all passes; a radius of 0 is replaced by a measured one."""
        radius = self.initial_radius
        if radius == 0:
            rows = next(split_rows(sensor.film()))
            points = self._sample(scene, sensor, pass_seed(seed, 0, Stream.CAMERA), rows).points
            radius = propose_radius(scene, points, PathSettings(self.photons_per_pass), seed=seed)
        return PassSettings(
            photons_per_pass=self.photons_per_pass,
            initial_radius=radius,
            alpha=self.alpha,
            max_depth=self.depth_limit,
            rr_depth=self.rr_depth,
            direct=self.direct,
            glossy_walks=self.glossy_walks,
            edge_correction=self.edge_correction,
        )

    def _render_pass(self, sensor: mi.Sensor, passes: PhotonPasses, t: int) -> mi.TensorXf:
        """The contribution of pass ``t`` to the film, (H, W, C)."""
        parts, photons = [], passes.trace(t)
        for number, rows in enumerate(split_rows(sensor.film())):
            seed = pass_seed(passes.seed, t, Stream.CAMERA, number)
            walks = passes.settings.glossy_walks
            lamps = Lamps(passes.scene) if passes.settings.direct == "emitters" else None
            samples = self._sample(passes.scene, sensor, seed, rows, walks, lamps)
            radiance = photons.radiance(samples.points, samples.haze)
            radiance = samples.merge(radiance) * samples.weight
            found = dr.select(samples.points.opaque(), mi.Color3f(1), 0)
            alpha = samples.merge(found).x
            dr.eval(radiance, alpha)
            parts.append((samples.position, radiance, alpha))
        return reconstruct(sensor.film(), *map(concatenate, zip(*parts, strict=True)))

    def _sample(
        self,
        scene: mi.Scene,
        sensor: mi.Sensor,
        seed: int,
        rows: range,
        walks: int = 1,
        lamps: Lamps | None = None,
    ) -> FilmSamples:
        """Visible points of one ray per pixel of the given rows."""
        samples = sample_film(
            scene,
            sensor,
            seed,
            self.depth_limit,
            self.rr_depth,
            lamps=lamps,
            walks=walks,
            rows=rows,
        )
        # Otherwise each kernel that needs the points would trace the walks again.
        dr.eval(samples)
        return samples

    def to_string(self) -> str:
        """A description, for print."""
        return (
            f"SPPM[passes={self.passes}, photons_per_pass={self.photons_per_pass}, "
            f"initial_radius={self.initial_radius}, alpha={self.alpha}, "
            f"max_depth={self.depth_limit}, rr_depth={self.rr_depth}]"
        )


mi.register_integrator("sppm", SPPM)

"""``<integrator type="sppm">``: stochastic progressive photon mapping."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi

from gpf.integrators.properties import is_number, read_depths, whole_number
from gpf.materials import require_separable
from gpf.progressive import PassSettings, PhotonPasses, pass_seed, propose_radius, sample_film


def define() -> type:
    """Make the class for the active variant."""

    class SPPM(mi.ad.integrators.common.ADIntegrator):
        r"""Stochastic progressive photon mapping (Hachisuka and Jensen 2009).

        .. pluginparameters::

         * - passes
           - |int|
           - Passes to average, each with one sample per pixel. The ``spp`` argument of
             ``mi.render`` takes precedence where it is given. (Default: 64)
         * - photons_per_pass
           - |int|
           - Photon paths emitted in each pass. (Default: 100000)
         * - initial_radius
           - |float|
           - Kernel radius of the first pass in world units; 0 measures the photon density in a
             pilot pass and chooses. (Default: 0)
         * - alpha
           - |float|
           - How much of the photons' number each pass keeps, in (0, 1). Radii shrink by
             :math:`r_{t+1} = r_t \sqrt{(t + \alpha) / (t + 1)}`. (Default: 0.7)
         * - max_depth
           - |int|
           - Longest path in edges, with the meaning that it has in ``path``; -1 is no limit.
             (Default: -1)
         * - rr_depth
           - |int|
           - Interactions before Russian roulette starts. (Default: 5)
         * - direct
           - |string|
           - Where light straight from the emitters comes from: ``photons``, like all other light,
             or a sample of the ``emitters`` at each visible point, which has less noise and sharp
             shadows. Caustics are made of photons either way. (Default: photons)

        Camera rays go through glossy and specular bounces and end at the first diffuse hit. The
        estimate is consistent: its bias vanishes with the radius as passes accumulate.

        Left out on purpose: participating media, polarisation, derivatives, and spectral
        variants.

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
            self.direct = props.get("direct", "photons")
            if self.direct not in ("photons", "emitters"):
                raise ValueError(f'"direct" is {self.direct!r}; choose "photons" or "emitters".')

        def settings(self, scene: mi.Scene, sensor: mi.Sensor, seed: int) -> PassSettings:
            """Settings of all passes, with the automatic radius measured where it is asked for."""
            radius = self.initial_radius
            if radius == 0:
                sampler, _ = self.prepare(sensor, pass_seed(seed, 0, stream=1), 1, [])
                film = sample_film(scene, sensor, sampler, self.depth_limit, self.rr_depth)
                dr.eval(film)
                radius = propose_radius(scene, film.points, self.photons_per_pass, seed)
            return PassSettings(
                self.photons_per_pass,
                radius,
                self.alpha,
                self.depth_limit,
                self.rr_depth,
                self.direct,
            )

        def render(
            self,
            scene: mi.Scene,
            sensor: Any = 0,
            seed: Any = 0,
            spp: int = 0,
            develop: bool = True,
            evaluate: bool = True,
        ) -> Any:
            if isinstance(sensor, int):
                sensor = scene.sensors()[sensor]
            require_separable(scene)
            seed = int(dr.slice(seed)) if not isinstance(seed, int) else seed
            film = sensor.film()
            with dr.suspend_grad():
                passes = PhotonPasses(scene, self.settings(scene, sensor, seed), seed)
                for t in range(1, (spp or self.passes) + 1):
                    sampler, _ = self.prepare(sensor, pass_seed(seed, t, stream=1), 1, [])
                    if t == 1:
                        block = film.create_block()
                        block.set_coalesce(False)
                    samples = sample_film(
                        scene,
                        sensor,
                        sampler,
                        self.depth_limit,
                        self.rr_depth,
                        direct=self.direct == "emitters",
                    )
                    # Or every kernel that needs the points would walk to them again.
                    dr.eval(samples)
                    irradiance = passes.irradiance(samples.points, t)
                    mi.ad.integrators.common.ADIntegrator._splat_to_block(
                        block,
                        film,
                        samples.position,
                        value=samples.points.radiance(irradiance) * samples.weight,
                        weight=1.0,
                        alpha=dr.select(samples.points.valid, mi.Float(1), mi.Float(0)),
                        aovs=[],
                        wavelengths=samples.wavelengths,
                    )
                    # One launch per pass: memory stays that of one pass.
                    dr.eval(block.tensor())
                film.put_block(block)
                return film.develop() if develop else None

        def to_string(self) -> str:
            return (
                f"SPPM[passes={self.passes}, photons_per_pass={self.photons_per_pass}, "
                f"initial_radius={self.initial_radius}, alpha={self.alpha}, "
                f"max_depth={self.depth_limit}, rr_depth={self.rr_depth}]"
            )

    return SPPM


def register() -> None:
    """Register the plugin for the active variant."""
    mi.register_integrator("sppm", define())

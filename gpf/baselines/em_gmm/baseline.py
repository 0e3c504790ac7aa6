"""EM-GMM: photons as a Gaussian mixture in space (Jakob, Regg and Jarosz 2011), read on surfaces.

The method was made for participating media. There, photons of power Φ_i lie where light collides
with the medium, and a mixture that is fitted to them gives the power per volume,

    Σ_i Φ_i δ(x - x_i)  ≈  Σ_s Φ_s g_s(x) = σ_t(x) φ(x)  [W/m³],    ∫ g_s dV = 1,

from which the fluence φ [W/m²] and the radiance follow. In a scene without media, photons lie on
surfaces, and what is asked for is the power per area, the irradiance E [W/m²]. The method knows
nothing of surfaces: its density takes the place of E, at the first diffuse hit of a camera ray,

    L = L_e + β ρ/π Σ_s Φ_s g_s(x),

with the BRDF ρ/π in place of phase function and albedo. (The original goes on to integrate along
camera rays; between the surfaces of a room there is nothing to integrate over.)

**Why it fails.** A kernel on a surface S has to satisfy ∫_S g dS = 1. A Gaussian that integrates
to 1 over the volume does not. Close to a plane with irradiance E, at the height z above it, with
photons as kernels of the bandwidth ε, perfectly fitted,

    Σ_s Φ_s g_s(x) = E exp(-z²/2ε²) / (√(2π) ε)  [W/m³]:

what is read off on the plane is E / (√(2π) ε), the right number only where √(2π) ε happens to be
one unit of length. With the room measured in other units, the image gets brighter or darker. In a
volume, more photons and a smaller ε lead to the right answer; here they lead to infinity. In
corners, on curved surfaces and at thin walls ∫_S g dS has yet other values, which depend on how S
lies in the Gaussian and have no closed form.

It is not the fit that fails: the option ``normalisation: plane`` multiplies by √(2π) ε, which is
right on planes and away from their edges, and no part of the method. The Cornell box then comes to
27 dB in place of 6.

This implementation's own are the photons' kernels, which keep covariances from collapsing
(:mod:`gpf.baselines.em_gmm.progressive_em`), and the density's grid. Left out: the levels of detail that
make distant media cheaper to render.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.baselines.em_gmm.gaussian_mixture import GaussianMixture
from gpf.baselines.em_gmm.mixture_density import MixtureDensity
from gpf.baselines.em_gmm.progressive_em import ProgressiveMixture
from gpf.baselines.options import EmGmmOptions
from gpf.baselines.protocol import CannotServe, Task
from gpf.camera.film import sample_film
from gpf.core.random import Stream, pass_seed
from gpf.core.structs import to_numpy
from gpf.guiding.photon_map import BATCH
from gpf.photons.tracing import PathSettings, record_photons
from gpf.scene.bounds import bounding_box, scene_bounds
from gpf.scene.materials import has_gloss, inseparable_materials
from gpf.scene.sensors import make_sensor
from gpf.scene.views import View

# Camera walks of a sample that meets a glossy surface first.
_GLOSSY_WALKS = 8

# In units of the scene's diagonal: variances are differences of squared coordinates.
_LEAST_BANDWIDTH = 1e-5

# Mean, covariance and flux of a component, float32.
_COMPONENT_BYTES = 4 * (3 + 6 + 3)


class EmGmm:
    """The system; see the module. A preparation takes seconds and leaves nothing in its state."""

    def __init__(self, options: EmGmmOptions) -> None:
        self.options = options

    def prepare(self, task: Task) -> PreparedMixture:
        """Trace photons in several passes, and fit the mixture as they come."""
        if names := inseparable_materials(task.scene):
            raise CannotServe(
                task.name,
                f"no materials of type {', '.join(names)}",
                "Use plastic, roughplastic, or a blendbsdf with a diffuse part.",
            )
        options = self.options
        corners = bounding_box(task.scene)
        least = _LEAST_BANDWIDTH * float(np.linalg.norm(corners[1] - corners[0]))
        if options.bandwidth != "auto" and options.bandwidth < least:
            raise CannotServe(
                task.name,
                f"a bandwidth of {options.bandwidth:g} is lost in rounding",
                f"Give {least:.1g} or more, or auto.",
            )
        bandwidth = None if options.bandwidth == "auto" else options.bandwidth
        fit = ProgressiveMixture(options.components, bandwidth)
        passes = min(max(options.passes, math.ceil(options.paths / BATCH)), options.paths)
        ends = np.linspace(0, options.paths, passes + 1).astype(int)
        for t, paths in enumerate(np.diff(ends).tolist()):
            seed = pass_seed(task.seed, t, Stream.EM_PHOTONS)
            photons = record_photons(
                task.scene, PathSettings(paths, rr_depth=task.rr_depth), seed=seed
            )
            if dr.width(photons.p) > 0:
                powers = to_numpy(photons.power) * (paths / options.paths)
                fit.add(to_numpy(photons.p), powers)
            task.report(t + 1, passes)
        if fit.mixture is None:
            raise CannotServe(
                task.name,
                "no photon lands on a diffuse surface",
                "Check where the emitters point, or trace more paths.",
            )
        return PreparedMixture(task, options, fit)


class PreparedMixture:
    """A scene's mixture, ready for any view.

    Attributes
    ----------
    mixture: the Gaussians with their flux, watts.
    bandwidth: ε, world units.
    """

    def __init__(self, task: Task, options: EmGmmOptions, fit: ProgressiveMixture) -> None:
        assert fit.mixture is not None and fit.bandwidth is not None
        self.task, self.options = task, options
        self.mixture: GaussianMixture = fit.mixture
        self.bandwidth: float = fit.bandwidth
        self._photons, self._bound = fit.photons, fit.bound
        self._density = MixtureDensity(self.mixture, scene_bounds(task.scene))
        self._walks = _GLOSSY_WALKS if has_gloss(task.scene) else 1

    @property
    def storage_bytes(self) -> int:
        """Mean, covariance and flux of all components, float32."""
        return _COMPONENT_BYTES * len(self.mixture)

    @property
    def facts(self) -> Mapping[str, float | str]:
        """How the fit went, and by how much planes are too bright."""
        return {
            "photons": self._photons,
            "components": len(self.mixture),
            "bandwidth": self.bandwidth,
            "log_likelihood": self._bound,
            "factor_on_planes": self._scale / plane_thickness(self.bandwidth),
        }

    def render(self, view: View, seed: int) -> np.ndarray:
        """A view's radiance, W/(m² sr), (H, W, 3) float32, linear."""
        width, height = self.task.size
        sensor = make_sensor(view, width, height)
        scale = dr.opaque(mi.Float, self._scale)
        total = np.zeros((width * height, 3))
        for k in range(self.options.spp):
            film = sample_film(
                self.task.scene,
                sensor,
                pass_seed(seed, k, Stream.EM_CAMERA),
                rr_depth=self.task.rr_depth,
                walks=self._walks,
            )
            dr.eval(film)
            points = film.points
            density = self._density(points.p, points.valid)
            total += to_numpy(film.merge(points.radiance(scale * density)))
        return (total / self.options.spp).reshape(height, width, 3).astype(np.float32)

    @property
    def _scale(self) -> float:
        """What the density is multiplied by."""
        return plane_thickness(self.bandwidth) if self.options.normalisation == "plane" else 1.0


def plane_thickness(bandwidth: float) -> float:
    """√(2π) ε: how thick a plane of photons is made, world units."""
    return math.sqrt(2 * math.pi) * bandwidth

"""EM-GMM: photons as a Gaussian mixture in space (Jakob, Regg and Jarosz 2011), used on surfaces.

The method was made for participating media. There, photons of power Φ_i lie where light collides
with the medium. A mixture fitted to them gives the power per volume,

    Σ_i Φ_i δ(x - x_i)  ≈  Σ_s Φ_s g_s(x) = σ_t(x) φ(x)  [W/m³],    ∫ g_s dV = 1,

from which the fluence φ [W/m²] and the radiance follow. In a scene without media, photons lie on
surfaces, and what is needed is the power per area, the irradiance E [W/m²]. The method does not
know the surfaces: its density is used as E at the first diffuse hit of a camera ray,

    L = L_e + β ρ/π Σ_s Φ_s g_s(x),

with the BRDF ρ/π instead of phase function and albedo. (The original also integrates along camera
rays; between the surfaces of a room there is no medium to integrate over.)

**Why it fails.** A kernel on a surface S has to satisfy ∫_S g dS = 1. A Gaussian that integrates
to 1 over the volume does not. Take a plane with irradiance E and a perfect fit of photons that are
kernels of bandwidth ε. At height z above the plane,

    Σ_s Φ_s g_s(x) = E exp(-z²/2ε²) / (√(2π) ε)  [W/m³].

On the plane this is E / (√(2π) ε), which is right only if √(2π) ε is one unit of length. If the
scene is scaled, the image gets brighter or darker. In a volume, more photons and a smaller ε
converge to the right result; here the result goes to infinity. In corners, on curved surfaces and
at thin walls, ∫_S g dS has other values, which depend on how S lies in the Gaussian and have no
closed form.

The fit itself is good: the option ``normalisation: plane``, which is not part of the method,
multiplies by √(2π) ε, the right factor on planes away from their edges. The Cornell Box then
reaches 27 dB instead of 6 dB.

Added here: the photons' kernels, which keep covariances from collapsing
(:mod:`baselines.em_gmm.progressive_em`), and the grid for the density. Left out: the levels of
detail that make distant media cheaper to render.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import drjit as dr
import mitsuba as mi
import numpy as np

from baselines.em_gmm.gaussian_mixture import GaussianMixture
from baselines.em_gmm.mixture_density import MixtureDensity
from baselines.em_gmm.progressive_em import ProgressiveMixture
from baselines.options import EmGmmOptions
from baselines.protocol import CannotServe, Task, refuse_media
from gpf.camera.film import sample_film
from gpf.core.random import Stream, pass_seed
from gpf.core.structs import to_numpy
from gpf.guiding.photon_map import BATCH
from gpf.photons.tracing import PathSettings, record_photons
from gpf.scene.bounds import bounding_box, scene_bounds
from gpf.scene.materials import has_gloss, inseparable_materials
from gpf.scene.sensors import make_sensor
from gpf.scene.views import View

# Camera walks for a sample whose first surface is glossy.
_GLOSSY_WALKS = 8

# In units of the scene's diagonal. Variances are differences of squares; for smaller bandwidths,
# they are lost in rounding.
_LEAST_BANDWIDTH = 1e-5

# Mean, covariance and flux of a component, float32.
_COMPONENT_BYTES = 4 * (3 + 6 + 3)


class EmGmm:
    """The system ``em_gmm``; its preparation takes seconds and writes no checkpoints."""

    def __init__(self, options: EmGmmOptions) -> None:
        self.options = options

    def prepare(self, task: Task) -> PreparedMixture:
        """Trace photons in several passes, and improve the mixture after each.

        Raises
        ------
        CannotServe: the diffuse part of a material cannot be separated, the bandwidth is too small,
            no photon lands on a diffuse surface, or the scene has media.
        """
        refuse_media(task.scene, task.name)
        if names := inseparable_materials(task.scene):
            raise CannotServe(
                task.name,
                f"materials of type {', '.join(names)} are not supported",
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
    """The mixture of a scene.

    Attributes
    ----------
    mixture: the Gaussians with their flux, W.
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
        """Figures of the fit; ``factor_on_planes``: how many times too bright planes are."""
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
        """Factor of the density."""
        return plane_thickness(self.bandwidth) if self.options.normalisation == "plane" else 1.0


def plane_thickness(bandwidth: float) -> float:
    """√(2π) ε: the effective thickness of a plane of photons, world units."""
    return math.sqrt(2 * math.pi) * bandwidth

"""Passes of stochastic progressive photon mapping; each depends on its index alone.

One pass traces photons and gathers them, with the radius of that pass, at any number of points: the
visible points of one or more views, and points whose irradiance is a training target. The estimate
is the mean over passes (Knaus and Zwicker 2011).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

import drjit as dr
import mitsuba as mi
import numpy as np
from pydantic import Field

from gpf.camera.next_event import samples_every_emitter
from gpf.core.random import Stream, pass_seed
from gpf.core.settings import Count, Positive, Settings
from gpf.core.spacing import measure_spacing
from gpf.core.spatial_hash import Record
from gpf.core.structs import Haze, Photons, VisiblePoints, from_numpy
from gpf.core.surface_tags import UNLIMITED, pack_tag, same_surface
from gpf.photons.density import PhotonCloud, PhotonDensity
from gpf.photons.emission import Source, emit_light
from gpf.photons.tracing import PathSettings, record_all
from gpf.scene.bounds import inside_box, scene_bounds
from gpf.scene.lamps import Lamps
from gpf.scene.materials import has_gloss
from gpf.scene.media import Media
from gpf.sppm.edge_correction import area_correction, ball_correction
from gpf.sppm.fixed_points import FixedPoints

# The photons around a point or a photon, up to this one, show how dense they are.
_NEIGHBOURS = 8

# The largest radius, in units of the scene's diagonal.
_WIDEST = 5e-2


class PassSettings(Settings):
    """Settings that all passes share.

    Attributes
    ----------
    photons_per_pass: emitted photon paths.
    initial_radius: kernel radius of the first pass, world units.
    alpha: radius reduction, in (0, 1); see :func:`radius_at`.
    max_depth: longest path in edges, as in Mitsuba's ``path``; -1: no limit.
    rr_depth: interactions before Russian roulette.
    direct: source of direct light at visible and fixed points: ``photons``, like all other light,
        or a sample of the ``emitters``.
    glossy_walks: number of camera walks for a sample whose first surface is glossy; see
        :class:`gpf.camera.film.FilmSamples`.
    edge_correction: whether to divide by only the part of the kernel's disc that lies on the
        surface, instead of the whole disc; see :mod:`gpf.sppm.edge_correction`.
    """

    photons_per_pass: Count = 100_000
    initial_radius: Positive = 0.02
    alpha: Annotated[float, Field(gt=0, lt=1)] = 0.7
    max_depth: Annotated[int, Field(ge=-1)] = -1
    rr_depth: Count = 5
    direct: Literal["photons", "emitters"] = "emitters"
    glossy_walks: Count = 8
    edge_correction: bool = True

    def path_settings(self, source: Source = emit_light) -> PathSettings:
        """The photon paths of a pass."""
        return PathSettings(
            self.photons_per_pass,
            max_depth=self.max_depth,
            rr_depth=self.rr_depth,
            source=source,
            indirect=self.direct == "emitters",
        )


def suit_scene(settings: PassSettings, scene: mi.Scene) -> PassSettings:
    """The settings, adapted to a scene: a single walk if no surface is glossy; direct light from
    photons if one of the emitters cannot be sampled."""
    walks = settings.glossy_walks if has_gloss(scene) else 1
    direct = settings.direct if samples_every_emitter(scene) else "photons"
    return settings.model_copy(update={"glossy_walks": walks, "direct": direct})


def radius_at(t: int, initial_radius: float, alpha: float, dimensions: int = 2) -> float:
    """Radius of pass ``t`` (counted from 1), in the unit of ``initial_radius``.

    With the d = 2 dimensions of surfaces, or the three of media, the recurrence
    r_{t+1}^d = r_t^d (t + α) / (t + 1) (Knaus and Zwicker 2011) in closed form, so that a pass does
    not depend on earlier ones:

        r_t^d = r_1^d Γ(t + α) / (Γ(1 + α) Γ(t + 1))
    """
    from scipy.special import gammaln

    log_ratio = gammaln(t + alpha) - gammaln(1 + alpha) - gammaln(t + 1)
    return float(initial_radius * np.exp(log_ratio / dimensions))


class PhotonPasses:
    """The photon passes of a scene.

    The result of pass ``t`` is a function of the scene, the settings, the seed and ``t``, bit for
    bit. It does not depend on earlier passes, nor on the order in which threads deliver photons.

    Parameters
    ----------
    source: emits the photons; see :func:`gpf.photons.tracing.trace_photons`.
    """

    def __init__(
        self, scene: mi.Scene, settings: PassSettings, seed: int, source: Source = emit_light
    ) -> None:
        self.scene, self.seed = scene, seed
        self.settings = suit_scene(settings, scene)
        self.paths = self.settings.path_settings(source)
        self.bounds = scene_bounds(scene)
        self._media_radius = 0.0
        if Media(scene).there:
            self._media_radius = propose_media_radius(scene, self.paths, seed, self.bounds)
        # Number of photons that the buffer must hold, judging by the passes so far.
        self._room: int | None = None

    def trace(self, t: int, photon_seed: int | None = None) -> PhotonPass:
        """Trace the photons of pass ``t`` (from 1); ``photon_seed`` replaces the seed of ``t``."""
        settings = self.settings
        if photon_seed is None:
            photon_seed = pass_seed(self.seed, t, Stream.PHOTONS)
        photons, floating = record_all(self.scene, self.paths, photon_seed, self._room)
        found = max(dr.width(photons.p), dr.width(floating.p))
        if self._room is None or found > self._room:
            # An eighth in reserve, because later passes may have a few more photons.
            self._room = max(self.paths.usual_capacity, found + found // 8)
        radius = radius_at(t, settings.initial_radius, settings.alpha)
        density = PhotonDensity(photons, radius, self.bounds)
        wide = radius_at(t, self._media_radius, settings.alpha, dimensions=3)
        cloud = PhotonCloud(floating, wide)
        return PhotonPass(self.scene, settings, density, cloud, radius, self.seed, t)


@dataclass(frozen=True)
class PhotonPass:
    """The photons of one pass; points gather light from them."""

    scene: mi.Scene
    settings: PassSettings
    density: PhotonDensity
    cloud: PhotonCloud
    radius: float
    seed: int
    t: int

    def irradiance(self, points: VisiblePoints) -> mi.Color3f:
        """Irradiance from photons at ``points``, W/m², (N, 3): all light, or only indirect
        light if direct light is sampled at the emitters."""
        p, n, valid = points.p, points.n, points.valid
        budget = self._budget(points.depth)
        irradiance = self.density.irradiance(p, n, valid, budget)
        if self.settings.edge_correction:
            edge_seed = pass_seed(self.seed, self.t, Stream.EDGES)
            irradiance *= area_correction(self.scene, p, n, valid, self.radius, edge_seed)
        return irradiance

    def scattered(self, haze: Haze) -> mi.Color3f:
        """Light scattered towards the camera at places in media, W/(m² sr), (N, 3), from the same
        photons as :meth:`irradiance`."""
        found = self.cloud.scattered(haze, self._budget(haze.depth))
        if self.settings.edge_correction and self.cloud.radius:
            edge_seed = pass_seed(self.seed, self.t, Stream.EDGES)
            found *= ball_correction(self.scene, haze.p, haze.valid, self.cloud.radius, edge_seed)
        return found

    def radiance(self, points: VisiblePoints, haze: Haze) -> mi.Color3f:
        """Radiance that cameras see, W/(m² sr), (N, 3)."""
        found = points.radiance(self.irradiance(points))
        return found + haze.radiance(self.scattered(haze)) if self.cloud.radius else found

    def _budget(self, depth: mi.UInt32) -> Any:
        """The greatest depth of photons: a path has depth + 1 edges from the camera and depth + 1
        edges from the photon."""
        if self.settings.max_depth <= 0:
            return UNLIMITED
        return max(self.settings.max_depth - 2, 0) - depth

    def all_irradiance(
        self, fixed: FixedPoints, start: mi.Point2f, number: int, lamps: Lamps | None = None
    ) -> tuple[mi.Color3f, mi.Color3f | None]:
        """E at fixed points, W/m², (N, 3), and the part of it from a sample of the emitters, or
        None if photons also carry direct light.

        Parameters
        ----------
        start: start of each point's sequence of samples, (N, 2); see
            :func:`gpf.core.random.random_start`.
        number: number of passes at these points so far, including this one.
        lamps: the emitters to sample; all by default.
        """
        if self.settings.direct == "photons":
            return self.irradiance(fixed.points), None
        direct, _ = fixed.direct_sums(start, number, lamps=lamps)
        return self.irradiance(fixed.points) + direct, direct


def propose_radius(
    scene: mi.Scene,
    points: VisiblePoints | Sequence[VisiblePoints],
    settings: PathSettings,
    seed: int = 0,
    photons_in_disc: float = 16.0,
) -> float:
    """A radius, world units, for which a typical visible point gathers ``photons_in_disc`` photons
    per pass.

    A pilot pass measures the photon density at the points: the distance to the 8th nearest photon
    on the same surface, median over 4096 samples. Of several views' points, each has its own
    radius, and the lower quartile of them is taken: a wide kernel would leak from the bright side
    of a wall, and a field has wider ones where photons are few. The radius is clamped to what
    single precision tells apart, and to 5e-2 of the scene's diagonal.
    """
    views = [points] if isinstance(points, VisiblePoints) else points
    traced = _trace_pilot(scene, settings, seed)
    radii = [_radius_of_view(scene, view, *traced, seed, photons_in_disc) for view in views]
    return _clamped(np.percentile(radii, 25, method="lower"), scene_bounds(scene))


def _radius_of_view(
    scene: mi.Scene,
    points: VisiblePoints,
    photons: Photons,
    floating: Photons,
    share: float,
    seed: int,
    photons_in_disc: float,
) -> float:
    bounds = scene_bounds(scene)
    lanes = dr.compress(points.valid)
    if min(dr.width(lanes), dr.width(photons.p)) == 0:
        return np.inf
    lanes = dr.gather(mi.UInt32, lanes, _choose(dr.width(lanes), seed))
    x, n = dr.gather(mi.Point3f, points.p, lanes), dr.gather(mi.Normal3f, points.n, lanes)

    def accept(index: mi.UInt32, record: Record, inside: mi.Bool) -> mi.Bool:
        """Photons behind a thin wall do not count; there may be many more of them."""
        return inside & same_surface(record, x, n, dr.squared_norm(record.p - x))

    tag = pack_tag(photons.n)
    factor = np.sqrt(photons_in_disc / _NEIGHBOURS * share)
    options = {"limit": _WIDEST / factor, "tag": tag, "accept": accept}
    return float(factor * measure_spacing(photons.p, x, _NEIGHBOURS, bounds, **options))


def propose_media_radius(
    scene: mi.Scene, settings: PathSettings, seed: int, bounds: Any, photons_in_ball: float = 16.0
) -> float:
    """A radius, world units, within which a typical photon in a medium has ``photons_in_ball``
    others per pass: from the distance to the 8th nearest, median over 4096 photons. Beyond all
    surfaces, where fog without walls holds photons, too, none counts."""
    _, floating, share = _trace_pilot(scene, settings, seed)
    within = mi.UInt32()
    if dr.width(floating.p):  # operations on nothing fail
        within = dr.compress(inside_box(floating.p, bounds))
    if dr.width(within) == 0:
        return _clamped(np.inf, bounds)
    near = dr.gather(mi.Point3f, floating.p, within)
    x = dr.gather(mi.Point3f, near, _choose(dr.width(within), seed))
    factor = (photons_in_ball / _NEIGHBOURS * share) ** (1 / 3)
    typical = measure_spacing(near, x, _NEIGHBOURS + 1, bounds, limit=_WIDEST / factor)
    return _clamped(factor * typical, bounds)


def _trace_pilot(
    scene: mi.Scene, settings: PathSettings, seed: int
) -> tuple[Photons, Photons, float]:
    """The photons of at most 200,000 paths, on surfaces and in media, and their share of a pass."""
    paths = min(settings.paths, 200_000)
    pilot = replace(settings, paths=paths, indirect=False)
    photons = record_all(scene, pilot, pass_seed(seed, 0, Stream.RADIUS_PHOTONS))
    return *photons, paths / settings.paths


def _choose(count: int, seed: int) -> mi.UInt32:
    """4096 indices below ``count``."""
    rng = np.random.default_rng(pass_seed(seed, 0, Stream.RADIUS_POINTS))
    return from_numpy(mi.UInt32, rng.integers(0, count, 4096))


def _clamped(radius: float, bounds: Any) -> float:
    """A radius that suits a scene."""
    diagonal = float(dr.norm(bounds[1] - bounds[0]))
    return float(np.clip(radius, 1e-7 * diagonal, _WIDEST * diagonal))

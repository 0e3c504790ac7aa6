"""The walk of photons through the scene; the only one in the project.

The caller's ``deposit`` gets the photons at diffuse surfaces; :func:`record_photons` stores them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from gpf.core.loops import loops_traced_once
from gpf.core.structs import Photons
from gpf.photons.emission import Source, emit_light
from gpf.scene.materials import (
    diffuse_transfer,
    has_diffuse,
    has_glossy_layers,
    has_null,
    reflected_share,
)
from gpf.scene.media import Media, Place, Visit

# Upper limit of a photon's power, relative to its initial power. The adjoint of shading normals
# has infinite variance. In a glass teapot it applies at every bounce: of 10^8 photons, one is 1000
# times as bright as the others and leaves a bright disc. The limit removes 0.3 % of the light where
# shading and geometric normals differ by 25°.
_MAX_GAIN = 16

# Largest probability of surviving Russian roulette after a collision in a medium: in milk, photons
# have hundreds of them.
_LIVES_IN_MEDIA = 0.99

Deposit = Callable[[Photons, "mi.Bool", "mi.Bool"], None]


@dataclass(frozen=True)
class PathSettings:
    """Number, length and emission of photon paths.

    Attributes
    ----------
    paths: number of emitted paths, the width of the wavefront.
    max_depth: longest path from emitter to camera in edges, as in Mitsuba's ``path``; -1: no
        limit. The camera has the last edge, so a photon has at most ``max_depth - 1`` interactions.
    rr_depth: number of interactions after which Russian roulette may end a path.
    source: makes the first rays and their powers, e.g. :func:`emit_light` or a guided emission.
    indirect: whether to leave out photons that come straight from an emitter, even through
        surfaces that do not bend light: the light that :meth:`gpf.scene.lamps.Lamps.sample` finds.
    """

    paths: int
    max_depth: int = -1
    rr_depth: int = 5
    source: Source = emit_light
    indirect: bool = False

    @property
    def usual_capacity(self) -> int:
        """The number of photons in a closed white room, an upper limit for most scenes.

        A path has ``rr_depth`` interactions, then about 20 until Russian roulette ends it.
        """
        return (min(self.rr_depth, 16) + 21) * self.paths


@loops_traced_once
@dr.syntax
def trace_photons(
    scene: mi.Scene,
    deposit: Deposit,
    settings: PathSettings,
    seed: int,
    float_by: Deposit | None = None,
) -> None:
    """Trace photon paths from the emitters and deposit photons on diffuse surfaces and in media.

    The expected sum of the powers at depth 0 is the part of the emitters' power that hits a diffuse
    surface first, W. A power may have negative channels: skies have colours that no display can
    show. A path ends where its power is not finite.

    Parameters
    ----------
    deposit: called in a recorded loop as ``deposit(photons, diffused, active)`` at each surface
        interaction; it has side effects, masked with ``active``. ``diffused``: whether a photon
        comes from a diffuse surface, directly or through something that does not change its
        direction.
    float_by: called like ``deposit``, with photons in media (:class:`gpf.core.structs.Photons`).
        There, ``diffused`` is whether a diffuse surface or a medium has scattered it at all.
    """
    paths, max_depth = settings.paths, settings.max_depth
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, paths)
    context = mi.BSDFContext(mi.TransportMode.Importance)
    deepest = dr.opaque(mi.UInt32, max_depth - 1 if max_depth > 0 else 0xFFFFFFFF)
    roulette_from = dr.opaque(mi.UInt32, settings.rr_depth)
    stores_direct = dr.opaque(mi.Bool, not settings.indirect)
    asks_null, has_layers = has_null(scene), has_glossy_layers(scene)

    ray, power, _ = settings.source(scene, sampler)
    power /= dr.opaque(mi.Float, paths)
    brightest = _size(power)
    depth, direct, diffused = mi.UInt32(0), mi.Bool(True), mi.Bool(False)
    active = (brightest > 0) & (deepest > 0)
    media = Media(scene)
    # Without media, these are no arrays: Dr.Jit traces a loop again to remove what does not change.
    medium: Any = None
    ratio, scattered_once, channel = medium, medium, medium
    phase = mi.PhaseFunctionContext(sampler, mi.TransportMode.Importance)
    if dr.hint(media.there, mode="scalar"):
        medium, ratio = media.around(ray, active), mi.Color3f(1)
        scattered_once, channel = mi.Bool(False), mi.UInt32(3 * sampler.next_1d())

    while dr.hint(active, exclude=[brightest, deepest, roulette_from, stores_direct, channel]):
        si = scene.ray_intersect(ray, active=active)
        scatters = mi.Bool(False)
        if dr.hint(media.there, mode="scalar"):
            stored = active & (stores_direct | ~direct)
            visit = _floating(float_by, power, depth, scattered_once, stored)
            flight = media.fly(medium, ray, si.t, channel, ratio, sampler, active, visit)
            power *= flight.weight
            ratio, scatters = flight.ratio, flight.scatters
        surface = active & si.is_valid() & ~scatters
        bsdf = si.bsdf(ray)

        # Adjoint of shading normals as in Mitsuba (Veach 1997, 5.3): flux arrives at the geometric
        # surface, but the BSDF uses the shading frame. Meshes may be wound against their normals.
        wi = si.to_world(si.wi)
        ng = dr.mulsign(si.n, dr.dot(si.n, si.sh_frame.n))
        wi_dot_ng = dr.dot(ng, wi)
        surface &= wi_dot_ng * si.wi.z > 0

        stored = surface & has_diffuse(bsdf, si) & (stores_direct | ~direct)
        slant = dr.abs(si.wi.z / wi_dot_ng)
        landing = power * slant * diffuse_transfer(bsdf, si, stored)
        photons = Photons(
            p=si.p,
            n=mi.Normal3f(dr.mulsign(ng, wi_dot_ng)),
            power=_limited(landing, _MAX_GAIN * brightest),
            depth=depth,
        )
        deposit(photons, diffused, stored & dr.all(dr.isfinite(photons.power)))

        sample, weight = bsdf.sample(
            context, si, sampler.next_1d(surface), sampler.next_2d(surface), surface
        )
        straight = mi.has_flag(sample.sampled_type, mi.BSDFFlags.Null)
        if dr.hint(asks_null, mode="scalar"):
            # Some wrappers, such as bumpmap, let photons through, but not the samples of lamps.
            straight &= dr.any(bsdf.eval_null_transmission(si, surface & straight) > 0)
        scattered = mi.has_flag(sample.sampled_type, mi.BSDFFlags.Diffuse)
        reflected = mi.Bool(scattered)
        if dr.hint(has_layers, mode="scalar"):  # which of them the light goes through
            share = reflected_share(bsdf, si, sample, surface)
            chance = dr.sum(share) / 3
            reflected = sampler.next_1d(surface) < chance
            weight *= dr.select(reflected, share / chance, (1 - share) / (1 - chance))
        diffused = dr.select(straight, diffused, reflected)
        direct &= straight
        wo = si.to_world(sample.wo)
        wo_dot_ng = dr.dot(ng, wo)
        leaks = wo_dot_ng * sample.wo.z <= 0
        correction = dr.abs((si.wi.z * wo_dot_ng) / (sample.wo.z * wi_dot_ng))
        factor = dr.select(leaks, 0, weight * correction)
        ray = si.spawn_ray(wo)
        lives = mi.Float(0.95)
        if dr.hint(media.there, mode="scalar"):
            here = flight.place.interaction()
            medium = dr.select(surface & si.is_medium_transition(), si.target_medium(wo), medium)
            numbers = sampler.next_1d(scatters), sampler.next_2d(scatters)
            turned, turning = medium.phase_function().sample(phase, here, *numbers, scatters)[:2]
            factor = dr.select(scatters, turning, factor)
            further = here.spawn_ray(turned)
            ray.o, ray.d = (
                dr.select(scatters, further.o, ray.o),
                dr.select(scatters, further.d, ray.d),
            )
            direct &= ~scatters
            diffused &= ~scatters
            scattered_once |= scatters | (surface & scattered)
            lives = dr.select(scatters, _LIVES_IN_MEDIA, lives)
        power = _limited(power * factor, _MAX_GAIN * brightest)
        active &= surface | scatters
        depth += 1

        # Russian roulette keeps the surviving photons' power near its initial value.
        survival = dr.minimum(_size(power) / brightest, lives)
        roulette = depth >= roulette_from
        survives = ~roulette | (sampler.next_1d(active) < survival)
        power[roulette] = power / survival
        active &= survives & dr.all(dr.isfinite(power)) & (_size(power) > 0) & (depth < deepest)


def _floating(
    deposit: Deposit | None,
    power: mi.Color3f,
    depth: mi.UInt32,
    scattered: mi.Bool,
    stored: mi.Bool,
) -> Visit:
    """Deposits photons at the places of a flight: w Φ at each, for which Σ w Φ / V is the fluence
    in a volume V."""

    def visit(place: Place, weight: mi.Color3f, active: mi.Bool) -> None:
        if deposit is not None:
            photons = Photons(p=place.p, n=mi.Normal3f(place.d), power=power * weight, depth=depth)
            deposit(photons, scattered, active & stored & dr.all(dr.isfinite(photons.power)))

    return visit


def _size(power: mi.Color3f) -> mi.Float:
    """The largest channel of a power, without its sign."""
    return dr.max(dr.abs(power))


def _limited(power: mi.Color3f, limit: mi.Float) -> mi.Color3f:
    """The power, scaled so that its largest channel is at most ``limit``."""
    greatest = _size(power)
    return power * dr.select(greatest > limit, limit / greatest, 1)


def record_photons(
    scene: mi.Scene, settings: PathSettings, seed: int, capacity: int | None = None
) -> Photons:
    """The photons of :func:`record_all` on surfaces, (N,)."""
    return record_all(scene, settings, seed, capacity)[0]


def record_all(
    scene: mi.Scene, settings: PathSettings, seed: int, capacity: int | None = None
) -> tuple[Photons, Photons]:
    """Trace photons and store all deposits in the order of paths: on surfaces, and in media.

    Parameters
    ----------
    capacity: number of photons to reserve memory for, on surfaces and in media each. If there are
        more, they are traced a second time. The default is :attr:`PathSettings.usual_capacity`.
    """
    capacity, foggy = capacity or settings.usual_capacity, Media(scene).there
    while True:
        surfaces = _Recorder(capacity, settings.paths)
        cloud = _Recorder(capacity, settings.paths) if foggy else None
        float_by = None if cloud is None else cloud.deposit
        trace_photons(scene, surfaces.deposit, settings, seed, float_by)
        counts = surfaces.landed(), cloud.landed() if cloud else 0
        if max(counts) <= capacity:
            floating = cloud.photons(counts[1]) if cloud else dr.zeros(Photons, 0)
            return surfaces.photons(counts[0]), floating
        del surfaces, cloud
        capacity = max(counts)


class _Recorder:
    """Appends photons to preallocated packets in a recorded loop."""

    def __init__(self, capacity: int, paths: int) -> None:
        self.capacity, self.paths = capacity, paths
        # The sort key holds the path and, in the rest of its 32 bits, the depth. Photons of a path
        # that are deeper than these bits allow keep the order of their deposits.
        self.depth_bits = 32 - max(paths - 1, 1).bit_length()
        self.count = dr.zeros(mi.UInt32, 1)
        self.place = dr.empty(mi.Float, 4 * capacity)
        self.power = dr.empty(mi.Float, 4 * capacity)
        self.normal = dr.empty(mi.Float, 4 * capacity)

    def deposit(self, photons: Photons, diffused: mi.Bool, active: mi.Bool) -> None:
        slot = dr.scatter_inc(self.count, mi.UInt32(0), active)
        active = active & (slot < dr.opaque(mi.UInt32, self.capacity))
        depth = dr.reinterpret_array(mi.Float, photons.depth)
        bits = dr.opaque(mi.UInt32, self.depth_bits)
        deepest = (mi.UInt32(1) << bits) - 1
        path = dr.arange(mi.UInt32, self.paths)
        key = (path << bits) | dr.minimum(photons.depth, deepest)
        key = dr.reinterpret_array(mi.Float, key)
        dr.scatter(self.place, mi.Vector4f(*photons.p, depth), slot, active)
        dr.scatter(self.power, mi.Vector4f(*photons.power, key), slot, active)
        dr.scatter(self.normal, mi.Vector4f(*photons.n, 0), slot, active)

    def landed(self) -> int:
        """The number of deposits, including those beyond the capacity."""
        dr.eval(self.count, self.place, self.power, self.normal)
        return int(self.count[0])

    def photons(self, count: int) -> Photons:
        # Slots are in the order of threads, which differs from run to run: sort.
        slots = dr.arange(mi.UInt32, count)
        keys = dr.gather(mi.Vector4f, self.power, slots).w
        order = dr.argsort(dr.reinterpret_array(mi.UInt32, keys))
        place, power, normal = (
            dr.gather(mi.Vector4f, packets, order)
            for packets in (self.place, self.power, self.normal)
        )
        photons = Photons(
            p=mi.Point3f(place.x, place.y, place.z),
            n=mi.Normal3f(normal.x, normal.y, normal.z),
            power=mi.Color3f(power.x, power.y, power.z),
            depth=dr.reinterpret_array(mi.UInt32, place.w),
        )
        dr.eval(photons)
        return photons

"""The walk of photons through the scene; the only one in the project.

The caller's ``deposit`` gets the photons at diffuse surfaces; :func:`record_photons` stores them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from gpf.core.loops import loops_traced_once
from gpf.core.structs import Photons
from gpf.photons.emission import Source, emit_light
from gpf.scene.materials import diffuse_transfer, has_diffuse, has_null

# Upper limit of a photon's power, relative to its initial power. The adjoint of shading normals
# has infinite variance. In a glass teapot it applies at every bounce: of 10^8 photons, one is 1000
# times as bright as the others and leaves a bright disc. The limit removes 0.3 % of the light where
# shading and geometric normals differ by 25°.
_MAX_GAIN = 16

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
def trace_photons(scene: mi.Scene, deposit: Deposit, settings: PathSettings, seed: int) -> None:
    """Trace photon paths from the emitters and deposit photons on diffuse surfaces.

    The expected sum of the powers at depth 0 is the part of the emitters' power that hits a diffuse
    surface first, W. A power may have negative channels: skies have colours that no display can
    show. A path ends where its power is not finite.

    Parameters
    ----------
    deposit: called in a recorded loop as ``deposit(photons, diffused, active)`` at each surface
        interaction; it has side effects, masked with ``active``. ``diffused``: whether a photon
        comes from a diffuse surface, directly or through something that does not change its
        direction.
    """
    paths, max_depth = settings.paths, settings.max_depth
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, paths)
    context = mi.BSDFContext(mi.TransportMode.Importance)
    deepest = dr.opaque(mi.UInt32, max_depth - 1 if max_depth > 0 else 0xFFFFFFFF)
    roulette_from = dr.opaque(mi.UInt32, settings.rr_depth)
    stores_direct, asks_null = dr.opaque(mi.Bool, not settings.indirect), has_null(scene)

    ray, power, _ = settings.source(scene, sampler)
    power /= dr.opaque(mi.Float, paths)
    brightest = _size(power)
    depth, direct, diffused = mi.UInt32(0), mi.Bool(True), mi.Bool(False)
    active = (brightest > 0) & (deepest > 0)

    while dr.hint(active, exclude=[brightest, deepest, roulette_from, stores_direct]):
        si = scene.ray_intersect(ray, active=active)
        active &= si.is_valid()
        bsdf = si.bsdf(ray)

        # Adjoint of shading normals as in Mitsuba (Veach 1997, 5.3): flux arrives at the geometric
        # surface, but the BSDF uses the shading frame.
        wi = si.to_world(si.wi)
        wi_dot_ng = dr.dot(si.n, wi)
        active &= wi_dot_ng * si.wi.z > 0

        stored = active & has_diffuse(bsdf, si) & (stores_direct | ~direct)
        slant = dr.abs(si.wi.z / wi_dot_ng)
        landing = power * slant * diffuse_transfer(bsdf, si, stored)
        photons = Photons(
            p=si.p,
            n=mi.Normal3f(dr.mulsign(si.n, wi_dot_ng)),
            power=_limited(landing, _MAX_GAIN * brightest),
            depth=depth,
        )
        deposit(photons, diffused, stored & dr.all(dr.isfinite(photons.power)))

        sample, weight = bsdf.sample(
            context, si, sampler.next_1d(active), sampler.next_2d(active), active
        )
        straight = mi.has_flag(sample.sampled_type, mi.BSDFFlags.Null)
        if dr.hint(asks_null, mode="scalar"):
            # Some wrappers, such as bumpmap, let photons through, but not the samples of lamps.
            straight &= dr.any(bsdf.eval_null_transmission(si, active & straight) > 0)
        scattered = mi.has_flag(sample.sampled_type, mi.BSDFFlags.Diffuse)
        diffused = dr.select(straight, diffused, scattered)
        direct &= straight
        wo = si.to_world(sample.wo)
        wo_dot_ng = dr.dot(si.n, wo)
        leaks = wo_dot_ng * sample.wo.z <= 0
        correction = dr.abs((si.wi.z * wo_dot_ng) / (sample.wo.z * wi_dot_ng))
        power *= dr.select(leaks, 0, weight * correction)
        power = _limited(power, _MAX_GAIN * brightest)
        ray = si.spawn_ray(wo)
        depth += 1

        # Russian roulette keeps the surviving photons' power near its initial value.
        survival = dr.minimum(_size(power) / brightest, 0.95)
        roulette = depth >= roulette_from
        lives = ~roulette | (sampler.next_1d(active) < survival)
        power[roulette] = power / survival
        active &= lives & dr.all(dr.isfinite(power)) & (_size(power) > 0) & (depth < deepest)


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
    """Trace photons and store all N deposits in the order of paths, (N,).

    Parameters
    ----------
    capacity: number of photons to reserve memory for. If there are more, they are traced a
        second time. The default is :attr:`PathSettings.usual_capacity`.
    """
    capacity = capacity or settings.usual_capacity
    while True:
        recorder = _Recorder(capacity, settings.paths)
        trace_photons(scene, recorder.deposit, settings, seed)
        count = recorder.landed()
        if count <= capacity:
            return recorder.photons(count)
        del recorder
        capacity = count


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

"""Lights -> photons: the only photon walk of the project.

What happens where a photon meets a diffuse surface is up to the caller's ``deposit``:
:func:`record_photons` keeps it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from gpf.core.structs import Photons
from gpf.photons.emission import Source, emit_light
from gpf.scene.materials import diffuse_transfer, has_diffuse

# A photon never has more than so many times the power that it set out with. The adjoint of shading
# normals has infinite variance, and is at work at every bounce within a glass teapot: of 10^8
# photons, one is a thousand times as bright as others, and a disc of light remains where it landed.
# Where shading and geometric normals are 25° apart, this takes away 0.3 % of the light.
_BRIGHTER = 16

Deposit = Callable[[Photons, "mi.Bool"], None]


@dataclass(frozen=True)
class PathSettings:
    """Photon paths: how many, how long, and where they start.

    Attributes
    ----------
    paths: number of emitted paths, the width of the wavefront.
    max_depth: the longest path from emitter to camera that a photon may be part of, counted in
        edges as Mitsuba's ``path`` does; -1 is no limit. A photon's last edge to the camera is
        not its own, so it interacts at most ``max_depth - 1`` times.
    rr_depth: number of interactions after which Russian roulette may end a path.
    source: gives the first rays with their powers; an emission guide has one of its own.
    indirect: whether photons straight from the emitters are left out.
    """

    paths: int
    max_depth: int = -1
    rr_depth: int = 5
    source: Source = emit_light
    indirect: bool = False

    @property
    def usual_capacity(self) -> int:
        """How many photons to expect at most in a closed white room: ``rr_depth`` interactions,
        then some 20 until Russian roulette ends a path."""
        return (min(self.rr_depth, 16) + 21) * self.paths


@dr.syntax
def trace_photons(scene: mi.Scene, deposit: Deposit, settings: PathSettings, seed: int) -> None:
    """Trace photon paths from the emitters and deposit photons on diffuse surfaces.

    Parameters
    ----------
    deposit: called inside a traced loop as ``deposit(photons, active)`` for each surface
        interaction; it acts by side effects masked with ``active``.

    Flux is conserved: the expected sum of deposited power at depth 0 is the part of the emitters'
    power that falls on diffuse surfaces first.
    """
    paths, max_depth = settings.paths, settings.max_depth
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, paths)
    context = mi.BSDFContext(mi.TransportMode.Importance)
    deepest = dr.opaque(mi.UInt32, max_depth - 1 if max_depth > 0 else 0xFFFFFFFF)
    roulette_from = dr.opaque(mi.UInt32, settings.rr_depth)
    stored_from = dr.opaque(mi.UInt32, int(settings.indirect))

    ray, power = settings.source(scene, sampler)
    power /= dr.opaque(mi.Float, paths)
    brightest = dr.max(power)
    depth = mi.UInt32(0)
    active = (brightest > 0) & (deepest > 0)

    while active:
        si = scene.ray_intersect(ray, active=active)
        active &= si.is_valid()
        bsdf = si.bsdf(ray)

        # Mitsuba's adjoint of shading normals (Veach 1997, 5.3): flux arrives at the geometric
        # surface, the BSDF sees the shading frame.
        wi = si.to_world(si.wi)
        wi_dot_ng = dr.dot(si.n, wi)
        active &= wi_dot_ng * si.wi.z > 0

        stored = active & has_diffuse(bsdf, si) & (depth >= stored_from)
        slant = dr.abs(si.wi.z / wi_dot_ng)
        landing = power * slant * diffuse_transfer(bsdf, si, stored)
        photons = Photons(
            p=si.p,
            n=mi.Normal3f(dr.mulsign(si.n, wi_dot_ng)),
            power=_limited(landing, _BRIGHTER * brightest),
            depth=depth,
        )
        deposit(photons, stored)

        sample, weight = bsdf.sample(
            context, si, sampler.next_1d(active), sampler.next_2d(active), active
        )
        wo = si.to_world(sample.wo)
        wo_dot_ng = dr.dot(si.n, wo)
        leaks = wo_dot_ng * sample.wo.z <= 0
        correction = dr.abs((si.wi.z * wo_dot_ng) / (sample.wo.z * wi_dot_ng))
        power *= dr.select(leaks, 0, weight * correction)
        power = _limited(power, _BRIGHTER * brightest)
        ray = si.spawn_ray(wo)
        depth += 1

        # Russian roulette keeps the surviving photons' power near its initial value.
        survival = dr.minimum(dr.max(power) / brightest, 0.95)
        roulette = depth >= roulette_from
        lives = ~roulette | (sampler.next_1d(active) < survival)
        power[roulette] = power / survival
        active &= lives & (dr.max(power) > 0) & (depth < deepest)


def _limited(power: mi.Color3f, limit: mi.Float) -> mi.Color3f:
    """A power whose greatest channel is at most ``limit``."""
    greatest = dr.max(power)
    return power * dr.select(greatest > limit, limit / greatest, 1)


def record_photons(
    scene: mi.Scene, settings: PathSettings, seed: int, capacity: int | None = None
) -> Photons:
    """Trace photons and keep them, path by path: (N,) with N the number of deposits.

    ``capacity`` is how many there is room for at first; if there are more, they are traced once
    more. The default is :attr:`PathSettings.usual_capacity`.
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
    """Appends photons to preallocated packets from inside a traced loop."""

    def __init__(self, capacity: int, paths: int) -> None:
        self.capacity, self.paths = capacity, paths
        # The rest of 32 bits is for the depth; photons of one path that are deeper than that keep
        # the order in which they came.
        self.depth_bits = 32 - max(paths - 1, 1).bit_length()
        self.count = dr.zeros(mi.UInt32, 1)
        self.place = dr.empty(mi.Float, 4 * capacity)
        self.power = dr.empty(mi.Float, 4 * capacity)
        self.normal = dr.empty(mi.Float, 4 * capacity)

    def deposit(self, photons: Photons, active: mi.Bool) -> None:
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
        """How many photons were deposited, with those for which there was no room."""
        dr.eval(self.count, self.place, self.power, self.normal)
        return int(self.count[0])

    def photons(self, count: int) -> Photons:
        # Slots are handed out in the order in which threads arrive.
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

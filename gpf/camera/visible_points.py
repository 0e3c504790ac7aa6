"""The walk of camera rays to their visible points; the only one in the project."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from gpf.camera.haze import View, lit_by, look_through
from gpf.camera.next_event import direct_light, share_of_bsdf
from gpf.camera.two_ways import GivenWay, RandomWay
from gpf.core.loops import loops_traced_once
from gpf.core.random import next_1d, next_2d
from gpf.core.structs import Arrival, Haze, VisiblePoints, Way
from gpf.scene.lamps import Lamps
from gpf.scene.materials import (
    diffuse_context,
    diffuse_reflectance,
    has_diffuse,
    has_others,
    is_glossy,
    specular_context,
)
from gpf.scene.media import Media


def find_visible_points(
    scene: mi.Scene,
    sampler: mi.Sampler,
    ray: mi.Ray3f,
    max_depth: int = -1,
    rr_depth: int = 5,
    active: mi.Bool | bool = True,
    lamps: Lamps | None = None,
) -> tuple[VisiblePoints, Haze]:
    """Follow rays through glossy and specular bounces to their first diffuse hit, (N,), and the
    places chosen in media on the way.

    This is :func:`walk` with all choices made at random and the result evaluated. The rays are
    evaluated first, so that one kernel serves all cameras: for a room with many materials, it takes
    a second or two to compile.
    """
    ray, none = mi.Ray3f(ray), dr.zeros(mi.Float, dr.width(ray))
    ray.o, ray.d = none + ray.o, none + ray.d
    ray.time, ray.maxt = none + ray.time, none + ray.maxt
    sampler.schedule_state()
    dr.make_opaque(ray)
    depths = max_depth, rr_depth
    points, _, haze, _ = walk(scene, sampler, ray, *depths, active, lamps)
    if Media(scene).there:
        points.emission += haze.radiance(lit_by(lamps, haze, sampler))
    dr.eval(points, haze)
    return points, haze


COHERENT = 4
"""Number of segments at the start of a walk on which the rays of a packet may still run side by
side. Embree traces these together, in as little as a quarter of the time, and later ones one by
one. The hits are the same."""


@loops_traced_once
@dr.syntax
def walk(
    scene: mi.Scene,
    sampler: mi.Sampler,
    ray: mi.Ray3f,
    max_depth: int = -1,
    rr_depth: int = 5,
    active: mi.Bool | bool = True,
    lamps: Lamps | None = None,
    back: mi.Bool | bool | None = None,
) -> tuple[VisiblePoints, Way, Haze, Arrival]:
    """Follow rays through glossy and specular bounces to their first diffuse hit, (N,), along one
    of two ways; on the way through media, choose a place in them.

    If a BSDF has a diffuse and other components, one of the two parts is chosen at random, with
    probabilities in proportion to their reflectances, and the throughput is divided by the
    probability. The emission of the points includes the emitters on the way and at the end of the
    ray, and the direct light on glossy lobes, because photons carry only the light that arrives at
    diffuse surfaces.

    Parameters
    ----------
    ray: one ray per lane of the sampler's wavefront, (N,).
    max_depth: longest path in edges, as in Mitsuba's ``path``; -1: no limit. The walk ends after
        ``max_depth`` edges; a visible point needs one more edge for its light.
    rr_depth: number of bounces after which Russian roulette may end a ray.
    active: lanes to follow.
    lamps: emitters whose direct light at the visible points is also included in the emission.
    back: which way rays take at their first surface (:class:`gpf.camera.two_ways.GivenWay`), (N,);
        None: one at random.
    """
    context = specular_context()
    deepest = dr.opaque(mi.UInt32, max_depth if max_depth >= 0 else 0xFFFFFFFF)
    roulette_from = dr.opaque(mi.UInt32, rr_depth)
    ways = RandomWay() if back is None else GivenWay(back)

    ray = mi.Ray3f(ray)
    throughput, emission = mi.Color3f(1), mi.Color3f(0)
    eta, depth = mi.Float(1), mi.UInt32(0)
    p, n = mi.Point3f(0), mi.Normal3f(0)
    reflectance, valid = mi.Color3f(0), mi.Bool(False)
    # The last glossy lobe with next event estimation: its point and the density of the direction.
    origin, density, lit = mi.Point3f(0), mi.Float(0), mi.Bool(False)
    way: Any = ways.start()
    active = mi.Bool(active) & (deepest > 0)
    media = Media(scene)
    # Without media, it is no array: Dr.Jit traces a loop again to remove what does not change.
    view: Any = None
    if dr.hint(media.there, mode="scalar"):
        view = View(media.around(ray, active), dr.zeros(Haze), mi.Float(0))

    while dr.hint(active, exclude=[deepest, roulette_from]):
        si = scene.ray_intersect(ray, mi.RayFlags.All, depth < COHERENT, active=active)
        if dr.hint(media.there, mode="scalar"):
            # Light that is scattered on the last edge would have come by one more.
            seen = ways.sees_light(depth) & (depth + 1 < deepest)
            view, through = look_through(
                view, media, ray, si.t, throughput, depth, seen, sampler, active
            )
            throughput *= through
        emitted = throughput * si.emitter(scene).eval(si, active)
        if lit:
            emitted *= share_of_bsdf(scene, si, origin, density, lit & active)
        emission += dr.select(active & ways.sees_light(depth), emitted, 0)
        active &= si.is_valid() & (depth + 1 < deepest)
        bsdf = si.bsdf(ray)
        fork = ways.fork(bsdf, si, depth)
        active &= ways.goes_on(fork, depth)

        diffuse = active & has_diffuse(bsdf, si)
        diffuse_part = diffuse_reflectance(bsdf, si, diffuse)
        choice = ways.choice(fork, next_1d(sampler, active))
        # Most surfaces of a room have nothing but a diffuse component.
        bends = active & has_others(bsdf)
        sample, weight = bsdf.sample(context, si, choice, next_2d(sampler, active), bends)
        way, factor = ways.through_glass(fork, way, sample, active)
        weight *= factor
        share = _share_of_diffuse(diffuse, diffuse_part, weight)
        way, share = ways.off_layers(fork, way, bsdf, share, active)

        # Rays from a glossy lobe rarely hit a small emitter: sample the emitters as well.
        lit = active & is_glossy(bsdf) & ~ways.leaves_out_gloss(fork)
        if lit:
            emission += throughput * direct_light(scene, sampler, context, bsdf, si, lit)
        ends = diffuse & (next_1d(sampler, active) < share)
        throughput /= dr.select(ends, share, 1 - share)
        lights = ends & mi.Bool(bool(lamps))
        if lights:
            arrival = Arrival(ray, medium_of(view))
            emission += throughput * light_of(lamps, sampler, bsdf, si, lights, arrival)
        if ends:
            p = mi.Point3f(si.p)
            n = mi.Normal3f(dr.mulsign(si.n, -dr.dot(si.n, ray.d)))
            reflectance = mi.Color3f(diffuse_part)
            valid = mi.Bool(True)
        active &= ~ends
        if active:
            throughput *= weight
            n = dr.select(mi.has_flag(sample.sampled_type, mi.BSDFFlags.Null), n, si.n)
            lit &= ~mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta)
            density = mi.Float(sample.pdf)
            origin = mi.Point3f(si.p)
            eta *= sample.eta
            ray = si.spawn_ray(si.to_world(sample.wo))
            if dr.hint(media.there, mode="scalar"):
                crossing = si.is_medium_transition()
                view.medium = dr.select(crossing, si.target_medium(ray.d), view.medium)
            depth += 1

        survival = dr.minimum(dr.max(throughput) * dr.square(eta), 0.95)
        roulette = active & (depth >= roulette_from)
        lives = ~roulette | (next_1d(sampler, active) < survival)
        throughput[roulette] = throughput / survival
        active &= lives & (dr.max(throughput) > 0)

    haze = dr.zeros(Haze)
    if dr.hint(media.there, mode="scalar"):
        haze = view.haze
        haze.weight *= view.chances
    points = VisiblePoints(p, n, reflectance, throughput, emission, depth, valid)
    way = Way(mi.Float(1), mi.Float(0)) if way is None else way
    return points, way, haze, Arrival(ray, medium_of(view))


def medium_of(view: View | None) -> mi.MediumPtr:
    """The medium that rays are in; none without media."""
    return dr.zeros(mi.MediumPtr) if view is None else view.medium


def follow(*where: Any, **options: Any) -> tuple[VisiblePoints, Way, Haze]:
    """As :func:`walk`, without the arrival."""
    return walk(*where, **options)[:3]


def _share_of_diffuse(diffuse: mi.Bool, reflectance: mi.Color3f, weight: mi.Color3f) -> mi.Float:
    """The probability that a walk ends at the diffuse component of a surface, (N,).

    The sampled ``weight`` approximates the albedo of the other lobes; the choice may depend on it,
    because it uses an independent random number.
    """
    from_diffuse, from_others = dr.max(reflectance), dr.max(weight)
    share = dr.select(diffuse, from_diffuse / (from_diffuse + from_others), 0)
    return dr.select(diffuse & (from_diffuse + from_others <= 0), 1, share)


def light_of(  # type: ignore[no-untyped-def]
    lamps: Lamps | None, sampler, bsdf, si, active, arrival: Arrival
) -> mi.Color3f:
    """The direct light of lamps on the diffuse component of surfaces at which rays arrive,
    W/(m² sr), (N, 3)."""
    context, total, medium = diffuse_context(), mi.Color3f(0), None
    if lamps and Media(lamps.scene).there:
        behind = si.target_medium(-arrival.ray.d)
        medium = dr.select(si.is_medium_transition(), behind, arrival.medium)
    for group in lamps.groups() if lamps else ():
        total += direct_light(group.scene, sampler, context, bsdf, si, active, group, medium)
    return total

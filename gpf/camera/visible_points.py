"""The walk of camera rays to their visible points; the only one in the project."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from gpf.camera.next_event import direct_light, share_of_bsdf
from gpf.core.random import next_1d, next_2d
from gpf.core.structs import VisiblePoints, Way
from gpf.scene.lamps import Lamps
from gpf.scene.materials import (
    diffuse_context,
    diffuse_reflectance,
    has_diffuse,
    has_others,
    is_glossy,
    is_smooth_glass,
    specular_context,
)


def find_visible_points(
    scene: mi.Scene,
    sampler: mi.Sampler,
    ray: mi.Ray3f,
    max_depth: int = -1,
    rr_depth: int = 5,
    active: mi.Bool | bool = True,
    lamps: Lamps | None = None,
) -> VisiblePoints:
    """Follow rays through glossy and specular bounces to their first diffuse hit, (N,).

    This is :func:`follow` with all choices made at random and the result evaluated. The rays are
    evaluated first, so that one kernel serves all cameras: for a room with many materials, it takes
    a second or two to compile.
    """
    ray, none = mi.Ray3f(ray), dr.zeros(mi.Float, dr.width(ray))
    ray.o, ray.d = none + ray.o, none + ray.d
    ray.time, ray.maxt = none + ray.time, none + ray.maxt
    sampler.schedule_state()
    dr.make_opaque(ray)
    points, _ = follow(scene, sampler, ray, max_depth, rr_depth, active, lamps)
    dr.eval(points)
    return points


COHERENT = 4
"""Number of segments at the start of a walk on which the rays of a packet may still run side by
side. Embree traces these together, in as little as a quarter of the time, and later ones one by
one. The hits are the same."""


OTHER_WAYS = 4
"""Where the other way from a first surface has weight F, a sample takes it with probability
min(1, OTHER_WAYS F): this many times as often as by chance. It then counts for less, which lowers
the noise of the picture, but takes time that could go into more samples."""

LEAST_OF_OTHERS, LEAST_OF_HOLES = 0.0625, 0.25
"""Lower limits of F, in that probability only, for components beside a diffuse one and for holes in
it: a sample of them may be zero by chance although they exist."""


@dr.syntax
def follow(
    scene: mi.Scene,
    sampler: mi.Sampler,
    ray: mi.Ray3f,
    max_depth: int = -1,
    rr_depth: int = 5,
    active: mi.Bool | bool = True,
    lamps: Lamps | None = None,
    back: mi.Bool | bool | None = None,
) -> tuple[VisiblePoints, Way]:
    """Follow rays through glossy and specular bounces to their first diffuse hit, (N,), along one
    of two ways.

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
    back: which of two ways rays take at their first surface, (N,). If it is smooth glass with
        Fresnel reflectance F, rays that go back are reflected, with weight F; the others pass
        through, with weight 1 - F. If it has a diffuse and other components, rays that go back
        leave by the other components; the rest end at the diffuse one. None: one of the ways at
        random. Allowed only in scenes for which :func:`gpf.scene.inventory.divides_walks` is true.
        The sum of both ways has the same mean as one way at random. At any other first surface, and
        with total reflection, rays that do not go back have weight 1, and those that do find
        nothing.
    """
    context = specular_context()
    diffusely = diffuse_context()
    deepest = dr.opaque(mi.UInt32, max_depth if max_depth >= 0 else 0xFFFFFFFF)
    roulette_from = dr.opaque(mi.UInt32, rr_depth)
    sampled = bool(lamps)
    dividing = back is not None
    reflected = mi.Bool(back) if dividing else mi.Bool(False)

    ray = mi.Ray3f(ray)
    throughput = mi.Color3f(1)
    emission = mi.Color3f(0)
    eta = mi.Float(1)
    depth = mi.UInt32(0)
    p = mi.Point3f(0)
    n = mi.Normal3f(0)
    reflectance = mi.Color3f(0)
    valid = mi.Bool(False)
    # The last glossy lobe with next event estimation: its point and the density of the direction.
    origin = mi.Point3f(0)
    density = mi.Float(0)
    lit = mi.Bool(False)
    side_weight, chance = dr.select(reflected, mi.Float(0), 1), mi.Float(0)
    active = mi.Bool(active) & (deepest > 0)

    while active:
        si = scene.ray_intersect(ray, mi.RayFlags.All, depth < COHERENT, active=active)
        emitted = throughput * si.emitter(scene).eval(si, active)
        if lit:
            emitted *= share_of_bsdf(scene, si, origin, density, lit & active)
        # The emission of the first surface counts for the walk that passes through.
        emitted = dr.select(reflected & (depth == 0), 0, emitted)
        emission += dr.select(active, emitted, 0)
        active &= si.is_valid() & (depth + 1 < deepest)
        bsdf = si.bsdf(ray)
        divided, layered = mi.Bool(False), mi.Bool(False)
        if dr.hint(dividing, mode="scalar"):
            divided = (depth == 0) & is_smooth_glass(bsdf)
            layered = (depth == 0) & has_diffuse(bsdf, si)
            active &= ~reflected | divided | layered | (depth > 0)

        diffuse = active & has_diffuse(bsdf, si)
        diffuse_part = diffuse_reflectance(bsdf, si, diffuse)
        choice = next_1d(sampler, active)
        if dr.hint(dividing, mode="scalar"):
            towards = dr.select(reflected, mi.Float(0), dr.one_minus_epsilon(mi.Float))
            choice = dr.select(divided, towards, choice)
        sample, weight = bsdf.sample(context, si, choice, next_2d(sampler, active), active)
        if dr.hint(dividing, mode="scalar"):
            # The density of one of two directions is its probability; for total reflection, 1.
            chosen = dr.select(reflected & (sample.pdf >= 1), 0, sample.pdf)
            side_weight = dr.select(divided & active, chosen, side_weight)
            chance = dr.select(divided & active, _chance(1 - chosen), chance)
            weight *= dr.select(divided, chosen, 1)
        wo = si.to_world(sample.wo)

        # Choose the part to follow. The sampled weight approximates the albedo of the other lobes;
        # the choice may depend on it, because it uses an independent random number.
        from_diffuse = dr.max(diffuse_part)
        from_others = dr.max(weight)
        share = dr.select(diffuse, from_diffuse / (from_diffuse + from_others), 0)
        share = dr.select(diffuse & (from_diffuse + from_others <= 0), 1, share)
        if dr.hint(dividing, mode="scalar"):
            layered &= active
            side_weight = dr.select(layered, dr.select(reflected, 1 - share, share), side_weight)
            masked = mi.has_flag(bsdf.flags(), mi.BSDFFlags.Null)
            least = dr.select(masked, mi.Float(LEAST_OF_HOLES), LEAST_OF_OTHERS)
            more = _chance(dr.maximum(1 - share, least))
            chance = dr.select(layered & has_others(bsdf), more, chance)
            share = dr.select(layered, dr.select(reflected, mi.Float(0), 1), share)

        # Rays from a glossy lobe rarely hit a small emitter: sample the emitters as well.
        lit = active & is_glossy(bsdf) & ~(layered & ~reflected)
        if lit:
            emission += throughput * direct_light(scene, sampler, context, bsdf, si, lit)
        ends = diffuse & (next_1d(sampler, active) < share)
        throughput /= dr.select(ends, share, 1 - share)

        lights = ends & mi.Bool(sampled)
        if lights:
            emission += throughput * _light_of(lamps, sampler, diffusely, bsdf, si, lights)
        if ends:
            p = mi.Point3f(si.p)
            n = mi.Normal3f(dr.mulsign(si.n, -dr.dot(si.n, ray.d)))
            reflectance = mi.Color3f(diffuse_part)
            valid = mi.Bool(True)
        active &= ~ends
        if active:
            throughput *= weight
            lit &= ~mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta)
            density = mi.Float(sample.pdf)
            origin = mi.Point3f(si.p)
            eta *= sample.eta
            ray = si.spawn_ray(wo)
            depth += 1

        survival = dr.minimum(dr.max(throughput) * dr.square(eta), 0.95)
        roulette = active & (depth >= roulette_from)
        lives = ~roulette | (next_1d(sampler, active) < survival)
        throughput[roulette] = throughput / survival
        active &= lives & (dr.max(throughput) > 0)

    points = VisiblePoints(
        p=p,
        n=n,
        reflectance=reflectance,
        throughput=throughput,
        emission=emission,
        depth=depth,
        valid=valid,
    )
    return points, Way(side_weight, chance)


def _chance(other: mi.Float) -> mi.Float:
    """Probability of taking the other way, (N,), if it has weight ``other``."""
    return dr.minimum(OTHER_WAYS * other, 1)


def _light_of(  # type: ignore[no-untyped-def]
    lamps: Lamps | None, sampler, context, bsdf, si, active
) -> mi.Color3f:
    """The direct light of lamps, W/(m² sr), (N, 3)."""
    total = mi.Color3f(0)
    for group in lamps.groups() if lamps else ():
        total += direct_light(group.scene, sampler, context, bsdf, si, active, group)
    return total

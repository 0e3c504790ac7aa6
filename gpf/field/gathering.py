"""Rays that gather the light of diffuse surfaces, and end in a field (final gathering).

A ray needs no kernel, which would blur the light and leak it through thin walls: what the surface
that it meets sends follows from what arrives there, and a field gives that. The surface is usually
far away, so small errors of the field average out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import drjit as dr
import mitsuba as mi

from gpf.camera.next_event import balance, direct_light, share_of_bsdf
from gpf.camera.recorded_steps import traced_step
from gpf.core.loops import loops_traced_once
from gpf.core.structs import VisiblePoints
from gpf.field.field import GaussianPhotonField
from gpf.field.shared_query import query_shared
from gpf.scene.lamps import Lamps
from gpf.scene.materials import diffuse_context, diffuse_reflectance, has_diffuse

RESOLVED = 0.25
"""Below this distance, in cells of the field's levels, a ray does not end in the field but goes on
as a path. In a centimetre-wide gap between a cupboard and a wall, the field would give the light of
the wall beside it."""

NEAR_FOR_PICTURES = 0.25
"""In a picture, ends of rays share an answer of the field if they are at most so many search radii
apart: their errors average out over its pixels."""

# Most surfaces that a ray meets: near ones, and those that it goes straight through.
_MOST_SURFACES = 8


def gathered_radiance(
    scene: mi.Scene,
    field: GaussianPhotonField,
    sampler: mi.Sampler,
    ray: mi.Ray3f,
    active: mi.Bool,
    density: mi.Float | None = None,
    near: float = 0,
    run: Callable[..., Any] = traced_step,
) -> mi.Color3f:
    """Radiance that diffuse surfaces send against rays, W/(m² sr), (N, 3).

        L = ρ E_f / π

    at the surface that a ray meets; E_f is the irradiance there: the field's answer, with samples
    of the lamps that the field does not store. If it is nearer than :data:`RESOLVED`, L is that of
    a path: samples of all emitters, and a further ray.

    Parameters
    ----------
    density: of the directions of the rays, 1/sr, (N,), to add the light of emitters that they meet,
        for its share in a mean with samples of them (:mod:`gpf.camera.next_event`); None: leave it
        out.
    near: how close ends of rays are that share an answer of the field, in search radii; 0: none do.
    run: :meth:`gpf.camera.recorded_steps.RecordedSteps.run`, if walks are recorded.
    """
    resolved = dr.opaque(mi.Float, _resolved(field))
    sees_lamps, density = density is not None, mi.Float(0) if density is None else density
    lamps = [field.settings.sampled_lamps(scene), Lamps(scene)]
    dr.eval(ray, active, density)
    ends = run(_follow, scene, sampler, lamps, ray, active, density, resolved, sees_lamps)
    arriving, _ = query_shared(field, ends.p, ends.n, ends.valid, near)
    return ends.radiance(dr.maximum(arriving, 0))


@loops_traced_once
@dr.syntax
def _follow(  # type: ignore[no-untyped-def]
    scene: mi.Scene,
    sampler: mi.Sampler,
    lamps: Sequence[Lamps],
    ray: mi.Ray3f,
    active: mi.Bool,
    density: mi.Float,
    resolved: mi.Float,
    sees_lamps: bool,
) -> VisiblePoints:
    """Where gather rays end, and the light that they bring besides, ``emission``, (N,).

    Parameters
    ----------
    lamps: those that the field does not store, and all.
    resolved: the distance of near surfaces, world units.
    """
    context, (outside, every) = diffuse_context(), lamps
    start, density = mi.Point3f(ray.o), mi.Float(density)
    ends = dr.zeros(VisiblePoints, dr.width(ray.d))
    p, n, reflectance = ends.p, ends.n, ends.reflectance
    emission, through = ends.emission, mi.Color3f(1)
    valid, counts = mi.Bool(False), dr.full(mi.Bool, sees_lamps, dr.width(ray.d))
    surfaces, active = mi.UInt32(0), mi.Bool(active)
    while dr.hint(active, exclude=[resolved]):
        si = scene.ray_intersect(ray, active=active)
        seen = active & counts & (si.emitter(scene) != dr.zeros(mi.EmitterPtr))
        share = share_of_bsdf(scene, si, start, density, seen)
        emission += through * share * si.emitter(scene).eval(si, seen)
        active &= si.is_valid()
        bsdf = si.bsdf()
        diffuse = active & has_diffuse(bsdf, si)
        straight = active & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Null)
        near = diffuse & (si.t < resolved) & ~straight
        if straight:
            # Cloth with holes: the ray goes through, or ends there.
            passing = bsdf.eval_null_transmission(si, straight)
            chance = dr.select(diffuse, dr.mean(passing), 1)
            straight &= sampler.next_1d(straight) < chance
            through *= dr.select(straight, passing / chance, 1 / (1 - chance))
        known = diffuse & ~near & ~straight
        sent, further = mi.Color3f(0), ray.d
        if known:
            p = mi.Point3f(si.p)
            n = mi.Normal3f(dr.mulsign(si.n, -dr.dot(si.n, ray.d)))
            reflectance = diffuse_reflectance(bsdf, si, known)
            valid = mi.Bool(True)
            if dr.hint(bool(outside), mode="scalar"):
                sent += direct_light(scene, sampler, context, bsdf, si, known, outside)
        if near:
            sent += _sample_lamps(every, bsdf, si, sampler, near)
        emission += through * sent

        if near:
            bounce, weight, pdf = _sample_diffuse(bsdf, si, sampler, near)
            through *= dr.select(near, weight, 1)
            further = dr.select(near, bounce, further)
            density = dr.select(near, pdf, density)
            start = dr.select(near, si.p, start)
            counts |= near
        surfaces += 1
        active = (straight | near) & dr.any(through > 0) & (surfaces < _MOST_SURFACES)
        ray = si.spawn_ray(further)
    return VisiblePoints(
        p=p,
        n=n,
        reflectance=reflectance,
        throughput=through,
        emission=emission,
        depth=surfaces,
        valid=valid,
    )


def _sample_diffuse(
    bsdf: mi.BSDFPtr, si: mi.SurfaceInteraction3f, sampler: mi.Sampler, active: mi.Bool
) -> tuple[mi.Vector3f, mi.Color3f, mi.Float]:
    """A direction for the diffuse component of a surface, world space, (N, 3), its weight
    f cos / p, (N, 3), and its density p, 1/sr, (N,): in proportion to the cosine. Not by
    ``bsdf.sample``, because Mitsuba's mask then samples its holes, whatever is asked for."""
    wo = mi.warp.square_to_cosine_hemisphere(sampler.next_2d(active))
    density = _density(wo)
    wo.z = dr.mulsign(wo.z, si.wi.z)
    weight = bsdf.eval(diffuse_context(), si, wo, active) / density
    return si.to_world(wo), dr.select(active & (density > 0), weight, 0), density


def _sample_lamps(
    lamps: Lamps,
    bsdf: mi.BSDFPtr,
    si: mi.SurfaceInteraction3f,
    sampler: mi.Sampler,
    active: mi.Bool,
) -> mi.Color3f:
    """Radiance of the diffuse component by a sample of the lamps, (N, 3): its share in a mean with
    rays from :func:`_sample_diffuse` that meet lamps. Without it, lamps a millimetre away would
    cause samples that are a million times too bright."""
    lamp, arriving = lamps.sample(si, sampler.next_2d(active), active)
    wo = si.to_local(lamp.d)
    share = balance(lamp.pdf, dr.select(lamp.delta, 0, _density(wo)))
    lit = active & (lamp.pdf > 0)
    return dr.select(lit, share * arriving * bsdf.eval(diffuse_context(), si, wo, lit), 0)


def _density(wo: mi.Vector3f) -> mi.Float:
    return dr.abs(wo.z) * dr.inv_pi


def _resolved(field: GaussianPhotonField) -> float:
    """:data:`RESOLVED` in world units; if the field has no levels, it counts search radii."""
    detail = field.detail
    return RESOLVED * (field.settings.search_radius if detail is None else detail.width)


def light_at(
    scene: mi.Scene,
    field: GaussianPhotonField,
    sampler: mi.Sampler,
    ray: mi.Ray3f,
    active: mi.Bool,
    run: Callable[..., Any] = traced_step,
) -> mi.Color3f:
    """Radiance of the diffuse component of the surfaces that rays meet, by light straight from the
    lamps and from other diffuse surfaces, W/(m² sr), (N, 3): a sample of the emitters and one
    gather ray share the former by the balance heuristic. ``run``: as in
    :func:`gathered_radiance`."""
    direct, onward, weight, density = run(_leave, scene, sampler, [Lamps(scene)], ray, active)
    found = gathered_radiance(
        scene, field, sampler, onward, dr.any(weight > 0), density, NEAR_FOR_PICTURES, run
    )
    return direct + weight * found


def _leave(
    scene: mi.Scene, sampler: mi.Sampler, lamps: Sequence[Lamps], ray: mi.Ray3f, active: mi.Bool
) -> tuple[Any, ...]:
    """The light of a sample of the emitters, (N, 3); a ray from the surface, its weight, (N, 3),
    and the density of its direction, (N,)."""
    si = scene.ray_intersect(ray, mi.RayFlags.All, coherent=True, active=active)
    active &= si.is_valid()
    bsdf = si.bsdf()
    light = _sample_lamps(lamps[0], bsdf, si, sampler, active)
    direction, weight, density = _sample_diffuse(bsdf, si, sampler, active)
    return light, si.spawn_ray(direction), weight, density

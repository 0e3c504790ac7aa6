"""Direct light by next event estimation, combined with sampling of the BSDF."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi


def direct_light(
    scene: mi.Scene,
    sampler: mi.Sampler,
    context: mi.BSDFContext,
    bsdf: mi.BSDFPtr,
    si: mi.SurfaceInteraction3f,
    active: mi.Bool,
    shared: bool = True,
) -> mi.Color3f:
    """Radiance towards ``si.wi`` from one point on one emitter, (N, 3).

        L = w f(wi, wo) |cos θ| L_e / p_e(wo),    w = p_e / (p_e + p_f)

    is the share of next event estimation; the other share, ``1 - w``, belongs to rays that go on
    by the BSDF's own density ``p_f``, and are weighted by :func:`share_of_bsdf` where they meet an
    emitter. The two add up to one whatever the probability with which a ray does go on, as long
    as its throughput makes up for that.

    Parameters
    ----------
    context: the components that f consists of.
    shared: whether the other share is accounted for elsewhere; w is 1 if not.
    """
    light, weight = scene.sample_emitter_direction(si, sampler.next_2d(active), True, active)
    active = active & (light.pdf > 0)  # no &=, which would change the caller's mask
    wo = si.to_local(light.d)
    if not shared:
        return dr.select(active, bsdf.eval(context, si, wo, active) * weight, 0)
    value, bsdf_pdf = bsdf.eval_pdf(context, si, wo, active)
    # A point or a direction of no extent can't be met by chance.
    bsdf_pdf = dr.select(light.delta, 0, bsdf_pdf)
    return dr.select(active, value * weight * balance(light.pdf, bsdf_pdf), 0)


def samples_every_emitter(scene: mi.Scene) -> bool:
    """Whether next event estimation finds the light of all emitters.

    A surface that shines in one direction alone (``directionalarea``) lights no point by chance.
    """
    beams = int(mi.EmitterFlags.Surface), int(mi.EmitterFlags.DeltaDirection)
    return not any(all(int(e.flags()) & flag for flag in beams) for e in scene.emitters())


def share_of_bsdf(
    scene: mi.Scene,
    si: mi.SurfaceInteraction3f,
    origin: mi.Point3f,
    bsdf_pdf: mi.Float,
    active: mi.Bool,
) -> mi.Float:
    """Weight ``1 - w`` of what is emitted at ``si`` towards ``origin``, (N,).

    Parameters
    ----------
    origin: where the ray that met ``si`` was scattered.
    bsdf_pdf: density ``p_f`` of its direction, 1/sr.
    active: whether next event estimation was done at ``origin``; 1 is the answer elsewhere.
    """
    before = dr.zeros(mi.Interaction3f)
    before.p = origin
    light = mi.DirectionSample3f(scene, si, before)
    active = active & (light.emitter != dr.zeros(mi.EmitterPtr))
    light_pdf = scene.pdf_emitter_direction(before, light, active)
    return dr.select(active, balance(bsdf_pdf, light_pdf), 1)


def balance(mine: mi.Float, other: mi.Float) -> mi.Float:
    """Weight of a sample among two strategies by the balance heuristic (Veach 1997), (N,)."""
    total = mine + other
    return dr.select(total > 0, mine / total, 0)

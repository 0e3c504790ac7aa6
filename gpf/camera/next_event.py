"""Direct light by next event estimation, combined with BSDF sampling."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from gpf.core.random import next_2d
from gpf.scene.lamps import Lamps


def direct_light(
    scene: mi.Scene,
    sampler: mi.Sampler,
    context: mi.BSDFContext,
    bsdf: mi.BSDFPtr,
    si: mi.SurfaceInteraction3f,
    active: mi.Bool,
    lamps: Lamps | None = None,
    medium: mi.MediumPtr | None = None,
) -> mi.Color3f:
    """Radiance towards ``si.wi`` from one sampled point on an emitter, W/(m² sr), (N, 3).

        L = w f(wi, wo) |cos θ| L_e / p_e(wo),    w = p_e / (p_e + p_f)

    The remaining weight ``1 - w`` belongs to rays that are sampled with the BSDF's density ``p_f``:
    :func:`share_of_bsdf` weights their emission. The weights add up to one. The probability that a
    ray is continued does not matter if its throughput is divided by it.

    Parameters
    ----------
    context: enables the components of f.
    lamps: the emitters to sample; w is then 1, as no rays contribute the remaining weight. By
        default, all emitters are sampled, but not through surfaces that do not bend light: rays
        that pass through these no longer know ``p_f``.
    medium: what the light comes through at the surface, if that is known.
    """
    sampled = Lamps(scene, through_null=False) if lamps is None else lamps
    light, weight = sampled.sample(si, next_2d(sampler, active), active, medium)
    active = active & (light.pdf > 0)  # not &=, which would change the caller's mask
    wo = si.to_local(light.d)
    if lamps is not None:
        return dr.select(active, bsdf.eval(context, si, wo, active) * weight, 0)
    value, bsdf_pdf = bsdf.eval_pdf(context, si, wo, active)
    # BSDF sampling never finds emitters of zero extent.
    bsdf_pdf = dr.select(light.delta, 0, bsdf_pdf)
    return dr.select(active, value * weight * balance(light.pdf, bsdf_pdf), 0)


def samples_every_emitter(scene: mi.Scene) -> bool:
    """Whether next event estimation finds the light of all emitters.

    It does not for ``directionalarea``, a surface that emits in a single direction: the sampled
    point on it almost never emits towards the lit point.
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
    """Weight ``1 - w`` of the emission at ``si`` towards ``origin``, (N,).

    Parameters
    ----------
    origin: the point where the ray to ``si`` was scattered, (N, 3).
    bsdf_pdf: density ``p_f`` of the ray's direction, 1/sr.
    active: whether next event estimation was done at ``origin``; if not, the weight is 1.
    """
    before = dr.zeros(mi.Interaction3f)
    before.p = origin
    light = mi.DirectionSample3f(scene, si, before)
    active = active & (light.emitter != dr.zeros(mi.EmitterPtr))
    light_pdf = Lamps(scene).density(before, light, active)
    return dr.select(active, balance(bsdf_pdf, light_pdf), 1)


def balance(mine: mi.Float, other: mi.Float) -> mi.Float:
    """Balance heuristic (Veach 1997): the weight mine / (mine + other) of a sample, (N,)."""
    total = mine + other
    return dr.select(total > 0, mine / total, 0)

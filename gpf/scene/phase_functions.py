"""How phase functions scatter light that comes from a lobe of directions."""

from __future__ import annotations

from functools import reduce
from operator import or_

import drjit as dr
import mitsuba as mi


def henyey_greenstein(g: mi.Float, cosine: mi.Float) -> mi.Float:
    """Henyey and Greenstein's function of the angle by which light turns, 1/sr, (N,); ``g``: its
    mean cosine."""
    rest = 1 + g * g - 2 * g * cosine
    return dr.inv_four_pi * (1 - g * g) * dr.square(dr.rsqrt(rest)) * dr.rsqrt(rest)


def scatter_lobes(
    medium: mi.MediumPtr, means: list[mi.Float], cosines: list[mi.Float]
) -> list[mi.Float]:
    """The share of lobes of light that media scatter into a direction, 1/sr, (N,) each.

    A lobe has Henyey and Greenstein's shape. A medium whose phase function has it, too, scatters a
    lobe into a lobe, and their mean cosines are multiplied. Any other phase function f turns

        (1 - r) / 4π + r f,

    which is exact for beams, and for the mean cosine of all lobes.

    Parameters
    ----------
    medium: the medium, (N,).
    means: the lobes' mean cosines r, 0 to 1, (N,) each.
    cosines: of the angles between the lobes' directions of flight and the direction, (N,) each.
    """
    others: list[mi.Medium] = []

    def mean_cosine(one: mi.Medium) -> mi.Float:
        phase = one.phase_function()
        if phase.class_name() == "HGPhaseFunction":
            return mi.Float(mi.traverse(phase)["g"])
        if phase.class_name() != "IsotropicPhaseFunction":
            others.append(one)
        return mi.Float(0)

    def turn(one: mi.Medium, *cosines: mi.Float) -> list[mi.Float]:
        return [_turn(one.phase_function(), cosine) for cosine in cosines]

    g = dr.dispatch(medium, mean_cosine)
    found = [henyey_greenstein(g * r, c) for r, c in zip(means, cosines, strict=True)]
    if others:
        is_other = reduce(or_, (medium == mi.MediumPtr(one) for one in others))
        turned = dr.dispatch(medium, turn, *cosines)
        for k, share in enumerate(turned):
            mixed = dr.lerp(dr.inv_four_pi, share, means[k])
            found[k] = dr.select(is_other, mixed, found[k])
    return found


def _turn(phase: mi.PhaseFunction, cosine: mi.Float) -> mi.Float:
    """A phase function's value, 1/sr, (N,)."""
    along = dr.zeros(mi.MediumInteraction3f, dr.width(cosine))
    along.wi = mi.Vector3f(0, 0, -1)
    along.sh_frame = mi.Frame3f(along.wi)
    sine = dr.safe_sqrt(1 - cosine * cosine)
    turned = mi.Vector3f(sine, 0, cosine)
    return mi.Float(phase.eval_pdf(mi.PhaseFunctionContext(), along, turned)[0].x)

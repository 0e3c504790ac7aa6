"""How phase functions scatter light that comes from a lobe of directions."""

from __future__ import annotations

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
    return list(dr.dispatch(medium, _scatter_in, means, cosines))


def _scatter_in(
    medium: mi.Medium, means: list[mi.Float], cosines: list[mi.Float]
) -> list[mi.Float]:
    phase = medium.phase_function()
    if phase.class_name() == "IsotropicPhaseFunction":
        return [dr.full(mi.Float, dr.inv_four_pi, dr.width(mean)) for mean in means]
    if phase.class_name() == "HGPhaseFunction":
        g = mi.traverse(phase)["g"]
        return [henyey_greenstein(g * r, c) for r, c in zip(means, cosines, strict=True)]
    return [
        dr.lerp(dr.inv_four_pi, _turn(phase, cosine), mean)
        for mean, cosine in zip(means, cosines, strict=True)
    ]


def _turn(phase: mi.PhaseFunction, cosine: mi.Float) -> mi.Float:
    """A phase function's value, 1/sr, (N,)."""
    along = dr.zeros(mi.MediumInteraction3f, dr.width(cosine))
    along.wi = mi.Vector3f(0, 0, -1)
    along.sh_frame = mi.Frame3f(along.wi)
    sine = dr.safe_sqrt(1 - cosine * cosine)
    turned = mi.Vector3f(sine, 0, cosine)
    return mi.Float(phase.eval_pdf(mi.PhaseFunctionContext(), along, turned)[0].x)

"""How much light Mitsuba's rough surfaces reflect, and how much Blender's do.

Light bounces between the microfacets of a rough surface. Mitsuba leaves this light out, Blender
does not: a white metal reflects everything, and a diffuse base gets what its layer leaves. Colours
are corrected so that both reflect the same under a uniform sky:

    metal    c' = c / (1 - c (1 - E))
    glass    c' = c / E
    layer    c' = c (1 - a) / b,   Mitsuba's albedo being a + b c

E is the albedo of Mitsuba's surface if it is white.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import drjit as dr
import mitsuba as mi

SAMPLES = 1 << 16


def metal_colour(colour: float, roughness: float) -> float:
    """The corrected colour of a channel of rough metal."""
    lost = 1 - _albedo("roughconductor", round(roughness, 2))
    return colour / (1 - min(colour, 1.0) * lost)


def glass_factor(roughness: float, ior: float) -> float:
    """The factor of the colour of rough glass."""
    return 1 / _albedo("roughdielectric", round(roughness, 2), round(ior, 2))


def layer_factor(roughness: float, specular: float) -> float:
    """The factor of the colour below a dielectric layer, for Mitsuba's `principled`."""
    rough, level = round(roughness, 2), round(specular, 2)
    a = _albedo("principled", rough, level, 0.0)
    return (1 - a) / (_albedo("principled", rough, level, 1.0) - a)


def layer_share(roughness: float, specular: float) -> float:
    """a: what a dielectric layer reflects, as in Mitsuba's `principled`."""
    return _albedo("principled", round(roughness, 2), round(specular, 2), 0.0)


@cache
def _albedo(kind: str, roughness: float, ior: float = 1.5, base: float = 1.0) -> float:
    """Mean reflectance, and transmittance, for directions in proportion to their cosine."""
    bsdf: dict[str, Any] = {"type": kind}
    if kind == "principled":
        colour = {"type": "rgb", "value": [base] * 3}
        bsdf |= {"roughness": roughness, "specular": ior, "base_color": colour}
    else:
        bsdf |= {"distribution": "ggx", "alpha": max(roughness**2, 1e-3)}
        bsdf |= (
            {"material": "none"} if kind == "roughconductor" else {"int_ior": ior, "ext_ior": 1.0}
        )
    # Not radiance, which changes where light enters glass.
    return share_under_sky(bsdf, mi.BSDFContext(mi.TransportMode.Importance), SAMPLES)


def share_under_sky(bsdf: dict[str, Any], context: mi.BSDFContext, samples: int) -> float:
    """The share of light under a uniform sky that leaves a BSDF by the components of a context."""
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(1, samples)
    si = dr.zeros(mi.SurfaceInteraction3f, samples)
    si.wi = mi.warp.square_to_cosine_hemisphere(sampler.next_2d())
    si.n = mi.Normal3f(0, 0, 1)
    si.sh_frame = mi.Frame3f(si.n)
    found, weight = mi.load_dict(bsdf).sample(context, si, sampler.next_1d(), sampler.next_2d())
    return float(dr.mean(dr.select(found.pdf > 0, weight.y, 0))[0])

"""The diffuse lobe of a Mitsuba BSDF, apart from its glossy and specular ones.

Photons are stored, and camera rays end, where a surface has a diffuse component. What happens
there needs that component alone. Of Mitsuba's BSDFs the diffuse lobes are separable in good
approximation (exactly so for ``diffuse``, ``plastic`` and ``roughplastic``, also inside
``twosided``, ``mask``, ``bumpmap`` and ``normalmap``):

    f_d(wi, wo) = g(wi) ρ(wo) / π    with g(n) = 1.

ρ is evaluated where a camera ray ends, g where a photon lands; their product needs no pairing of
photons and points.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

# Materials that answer for all their components whatever the context enables: their diffuse part
# cannot be told from the rest, and would count twice.
INSEPARABLE = {"Principled": "principled", "PrincipledThin": "principledthin"}


def inseparable_materials(scene: mi.Scene) -> list[str]:
    """Plugin names of the scene's materials that photon mapping cannot use, sorted; nested too."""
    objects = mi.traverse(scene).hierarchy
    found = {o.class_name() for o in objects if isinstance(o, mi.BSDF)}
    return sorted(INSEPARABLE[name] for name in found & INSEPARABLE.keys())


def require_separable(scene: mi.Scene) -> None:
    """Raise a ``ValueError`` for a scene with a material that photon mapping cannot use."""
    if names := inseparable_materials(scene):
        raise ValueError(
            f"the scene has materials of type {', '.join(names)}, whose diffuse part cannot be "
            "told from the rest. Use plastic, roughplastic, or a blendbsdf with a diffuse part."
        )


def diffuse_context(mode: mi.TransportMode | None = None) -> mi.BSDFContext:
    """A context that enables diffuse components only."""
    context = mi.BSDFContext(mode or mi.TransportMode.Radiance)
    context.type_mask = int(mi.BSDFFlags.Diffuse)
    return context


def specular_context(mode: mi.TransportMode | None = None) -> mi.BSDFContext:
    """A context that enables everything but diffuse components."""
    context = mi.BSDFContext(mode or mi.TransportMode.Radiance)
    context.type_mask = int(mi.BSDFFlags.All) & ~int(mi.BSDFFlags.Diffuse)
    return context


def has_diffuse(bsdf: mi.BSDFPtr, si: mi.SurfaceInteraction3f) -> mi.Bool:
    """Whether the side of the surface that ``si.wi`` lies on has a diffuse component, (N,)."""
    flags = bsdf.flags()
    two_sided = mi.has_flag(flags, mi.BSDFFlags.BackSide)
    return mi.has_flag(flags, mi.BSDFFlags.Diffuse) & ((si.wi.z > 0) | two_sided)


def is_glossy(bsdf: mi.BSDFPtr) -> mi.Bool:
    """Whether the surface has a component that spreads light, yet not diffusely, (N,)."""
    return mi.has_flag(bsdf.flags(), mi.BSDFFlags.Glossy)


def has_gloss(scene: mi.Scene) -> bool:
    """Whether any surface of the scene is glossy and nothing else (:func:`is_only_glossy`)."""
    objects = mi.traverse(scene).hierarchy
    kinds = [int(o.flags()) for o in objects if isinstance(o, mi.BSDF)]
    gloss, diffuse = int(mi.BSDFFlags.Glossy), int(mi.BSDFFlags.Diffuse)
    return any(flags & gloss and not flags & diffuse for flags in kinds)


def is_only_glossy(bsdf: mi.BSDFPtr) -> mi.Bool:
    """Whether the surface spreads light without a diffuse component, (N,)."""
    return is_glossy(bsdf) & ~mi.has_flag(bsdf.flags(), mi.BSDFFlags.Diffuse)


def diffuse_reflectance(
    bsdf: mi.BSDFPtr, si: mi.SurfaceInteraction3f, active: mi.Bool
) -> mi.Color3f:
    """ρ(wo) = π f_d(n, wo) for ``wo = si.wi``, (N, 3): light comes along the normal.

    Evaluated with the roles of the two directions exchanged (the lobe is symmetric).
    """
    normal = mi.Vector3f(0, 0, dr.select(si.wi.z > 0, 1, -1))
    return dr.pi * bsdf.eval(diffuse_context(), si, normal, active)


def diffuse_transfer(bsdf: mi.BSDFPtr, si: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.Color3f:
    """g(wi) = f_d(n, wi) / f_d(n, n) for ``wi = si.wi``, (N, 3); 1 where the lobe is Lambertian.

    Evaluated as the BSDF's answer for ``wi`` over the cosine at the surface. Where the BSDF has a
    normal of its own (``normalmap``, ``bumpmap``), the ratio of the two cosines is thus part of
    it: a facet that faces the light gets more than its share. A black lobe gives 1.
    """
    normal = mi.Vector3f(0, 0, dr.select(si.wi.z > 0, 1, -1))
    upright = mi.SurfaceInteraction3f(si)
    upright.wi = normal
    context = diffuse_context()
    slanted = bsdf.eval(context, upright, si.wi, active) / dr.abs(si.wi.z)
    straight = bsdf.eval(context, upright, normal, active)
    return dr.select(active & (straight > 0), slanted / straight, 1)

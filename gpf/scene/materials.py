"""The diffuse lobe of a Mitsuba BSDF, without its glossy and specular lobes.

Photons are stored, and camera rays end, at surfaces with a diffuse component, and only that
component is evaluated there. The diffuse lobes of Mitsuba's BSDFs are separable to a good
approximation (exactly for ``diffuse``, ``plastic`` and ``roughplastic``, also inside ``twosided``,
``mask``, ``bumpmap`` and ``normalmap``, and for this project's ``separable_principled`` and
``separable_principledthin``):

    f_d(wi, wo) = g(wi) ρ(wo) / π    with g(n) = 1.

ρ is evaluated where a camera ray ends and g where a photon lands, so nothing needs to be evaluated
per pair of photon and point.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from gpf.core.errors import UserError

# Materials that evaluate all components, whatever the context enables: their diffuse part cannot be
# separated and would count twice.
INSEPARABLE = {"Principled": "principled", "PrincipledThin": "principledthin"}


NOT_DIFFUSE = int(mi.BSDFFlags.All) & ~int(mi.BSDFFlags.Diffuse)
"""Flags of all components except diffuse ones."""


def inseparable_materials(scene: mi.Scene) -> list[str]:
    """Plugin names of materials that photon mapping cannot use, including nested ones, sorted."""
    objects = mi.traverse(scene).hierarchy.items()
    # This project's plugins contain one of Mitsuba's.
    found = {
        bsdf.class_name()
        for bsdf, (parent, _) in objects
        if isinstance(bsdf, mi.BSDF)
        and not (parent is not None and parent.class_name().startswith("SeparablePrincipled"))
    }
    return sorted(INSEPARABLE[name] for name in found & INSEPARABLE.keys())


def require_separable(scene: mi.Scene, where: str = "scene") -> None:
    """Raise a :class:`UserError` if the scene has a material that photon mapping cannot use."""
    if names := inseparable_materials(scene):
        raise UserError(
            where,
            f"has materials of type {', '.join(names)}, whose diffuse part cannot be separated",
            "Load the scene with gpf.load_scene_file, or prefix the type with separable_.",
        )


def diffuse_context(mode: mi.TransportMode | None = None) -> mi.BSDFContext:
    """A context that enables only diffuse components."""
    context = mi.BSDFContext(mode or mi.TransportMode.Radiance)
    context.type_mask = int(mi.BSDFFlags.Diffuse)
    return context


def specular_context(mode: mi.TransportMode | None = None) -> mi.BSDFContext:
    """A context that enables all components except diffuse ones."""
    context = mi.BSDFContext(mode or mi.TransportMode.Radiance)
    context.type_mask = NOT_DIFFUSE
    return context


def has_diffuse(bsdf: mi.BSDFPtr, si: mi.SurfaceInteraction3f) -> mi.Bool:
    """Whether the side of the surface that ``si.wi`` lies on has a diffuse component, (N,)."""
    flags = bsdf.flags()
    two_sided = mi.has_flag(flags, mi.BSDFFlags.BackSide)
    return mi.has_flag(flags, mi.BSDFFlags.Diffuse) & ((si.wi.z > 0) | two_sided)


def has_others(bsdf: mi.BSDFPtr) -> mi.Bool:
    """Whether the surface has components that are not diffuse, (N,)."""
    return (bsdf.flags() & NOT_DIFFUSE) != 0


def is_glossy(bsdf: mi.BSDFPtr) -> mi.Bool:
    """Whether the surface has a glossy component: neither diffuse nor perfectly specular, (N,)."""
    return mi.has_flag(bsdf.flags(), mi.BSDFFlags.Glossy)


def has_gloss(scene: mi.Scene) -> bool:
    """Whether any surface of the scene is glossy and has no diffuse component."""
    gloss, diffuse = int(mi.BSDFFlags.Glossy), int(mi.BSDFFlags.Diffuse)
    return any(flags & gloss and not flags & diffuse for flags in _all_flags(scene))


def has_glossy_layers(scene: mi.Scene) -> bool:
    """Whether any surface of the scene has both a diffuse and a glossy component."""
    layers = int(mi.BSDFFlags.Diffuse), int(mi.BSDFFlags.Glossy)
    return any(all(flags & layer for layer in layers) for flags in _all_flags(scene))


def has_null(scene: mi.Scene) -> bool:
    """Whether light passes through any surface of the scene without changing direction."""
    return any(flags & int(mi.BSDFFlags.Null) for flags in _all_flags(scene))


def _all_flags(scene: mi.Scene) -> list[int]:
    """The flags of all BSDFs of a scene, including nested ones."""
    return [int(o.flags()) for o in mi.traverse(scene).hierarchy if isinstance(o, mi.BSDF)]


def is_only_glossy(bsdf: mi.BSDFPtr) -> mi.Bool:
    """Whether the surface is glossy and has no diffuse component, (N,)."""
    return is_glossy(bsdf) & ~mi.has_flag(bsdf.flags(), mi.BSDFFlags.Diffuse)


def is_smooth_glass(bsdf: mi.BSDFPtr) -> mi.Bool:
    """Whether the surface reflects in one direction and transmits in one direction, (N,)."""
    flags = bsdf.flags()
    through = mi.has_flag(flags, mi.BSDFFlags.DeltaTransmission)
    through |= mi.has_flag(flags, mi.BSDFFlags.Null)
    back = mi.has_flag(flags, mi.BSDFFlags.DeltaReflection)
    return through & back & ~mi.has_flag(flags, mi.BSDFFlags.Diffuse) & ~is_glossy(bsdf)


def diffuse_reflectance(
    bsdf: mi.BSDFPtr, si: mi.SurfaceInteraction3f, active: mi.Bool
) -> mi.Color3f:
    """ρ(wo) = π f_d(n, wo) for ``wo = si.wi``, dimensionless, (N, 3), for light along the normal.

    Evaluated with swapped directions: the lobe is symmetric.
    """
    normal = mi.Vector3f(0, 0, dr.select(si.wi.z > 0, 1, -1))
    return dr.pi * bsdf.eval(diffuse_context(), si, normal, active)


def diffuse_transfer(bsdf: mi.BSDFPtr, si: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.Color3f:
    """g(wi) = f_d(n, wi) / f_d(n, n) for ``wi = si.wi``, (N, 3); 1 for Lambertian and black lobes.

    f_d is the value of the BSDF divided by the cosine at the surface. For a BSDF with its own
    normal (``normalmap``, ``bumpmap``), g therefore includes the ratio of the two cosines: a facet
    turned towards the light receives more.
    """
    normal = mi.Vector3f(0, 0, dr.select(si.wi.z > 0, 1, -1))
    upright = mi.SurfaceInteraction3f(si)
    upright.wi = normal
    context = diffuse_context()
    slanted = bsdf.eval(context, upright, si.wi, active) / dr.abs(si.wi.z)
    straight = bsdf.eval(context, upright, normal, active)
    return dr.select(active & (straight > 0), slanted / straight, 1)


@dr.syntax
def reflected_share(  # type: ignore[no-untyped-def]
    bsdf: mi.BSDFPtr, si: mi.SurfaceInteraction3f, sample: mi.BSDFSample3f, active: mi.Bool
) -> mi.Color3f:
    """The share f_d / f of the diffuse component in the light that leaves by a sampled direction,
    (N, 3).

    The type of a sample does not tell it: many BSDFs choose a direction by one component, and weigh
    it by all. What cloth and paper transmit diffusely is not part of the component.
    """
    same_side = active & (si.wi.z * sample.wo.z > 0) & has_diffuse(bsdf, si)
    same_side &= ~mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta)
    share = dr.select(same_side, mi.Color3f(1), 0)
    if same_side & is_glossy(bsdf):
        context = mi.BSDFContext(mi.TransportMode.Importance)
        diffuse = bsdf.eval(diffuse_context(context.mode), si, sample.wo, same_side)
        whole = bsdf.eval(context, si, sample.wo, same_side)
        share = dr.select(whole > diffuse, diffuse / whole, 1)
    return share

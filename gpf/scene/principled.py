"""The plugins ``separable_principled`` and ``separable_principledthin``: ``principled`` and
``principledthin`` with a separate diffuse component.

Mitsuba's plugins evaluate all their lobes together, whatever the context enables. Here they form
two components, a diffuse one and the rest:

    f = D + (f - D),    D(wi, wo) = q (1 - t) (1 - 3/8 s) a(wi) a(wo) c / π
    a(w) = 1 - (1 - |cos θ_w|)⁵ / 2
    q = 1 - m           for principled, 1 - d / 2 for principledthin

with the base colour c, the metallic fraction m, the transmission t, the diffuse transmission d (0
to 2) and the flatness s at the point. D is the part of the diffuse lobe (Burley 2012) that is a
product of a function of wi and one of wo, as :mod:`gpf.scene.materials` requires. It is never
larger than the lobe: retro-reflection, the rest of the flat lobe (at least 5/8 c / π) and sheen
only add to it. These belong to the second component, with the specular lobes, the clear coat, and
the light that a thin sheet transmits diffusely.

Scene files loaded with :func:`gpf.scene.load.load_scene_file` get these plugins in place of
Mitsuba's. The sum of the components is unchanged, so other integrators see no difference.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

# Fraction of the second component's directions that is sampled as for a diffuse surface. This finds
# retro-reflection and sheen; the specular lobes are sampled with their own distributions.
DIFFUSE_RATE = 0.2


class _Separable(mi.BSDF):
    """What the two plugins have in common.

    Attributes
    ----------
    original: the name of Mitsuba's plugin; this one has the same properties.
    two_sided: whether there is a diffuse component on both sides.
    taken_by, taken_share: q is 1 - ``taken_share`` times the parameter ``taken_by``.
    """

    original: str
    two_sided: bool
    taken_by: str
    taken_share: float

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        given = {name: props[name] for name in props.keys()}  # noqa: SIM118  # not a dictionary
        self.whole = mi.load_dict({"type": self.original} | given)
        rate = {"diffuse_reflectance_sampling_rate": DIFFUSE_RATE}
        self.rest = mi.load_dict({"type": self.original} | given | rate)
        self.base_color = props.get_texture("base_color", 0.5)
        self.taken = props.get_texture(self.taken_by, 0.0)
        self.transmission = props.get_texture("spec_trans", 0.0)
        self.flatness = props.get_texture("flatness", 0.0)
        components = [self.whole.flags(k) for k in range(self.whole.component_count())]
        self.m_components = components
        self.m_flags = self.whole.flags()

    def traverse(self, callback: Any) -> None:
        """Expose the parameters of Mitsuba's plugin."""
        callback.put(self.original, self.whole, mi.ParamFlags.NonDifferentiable)

    def eval(
        self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: Any = True
    ) -> mi.Color3f:
        """``f(wi, wo) |cos θ_o|`` for the enabled components, (N, 3)."""
        diffuse, rest = _enabled(ctx)
        if not rest:
            return self._diffuse(si, wo, active) if diffuse else mi.Color3f(0)
        value = self.whole.eval(_all_of(ctx), si, wo, active)
        return value if diffuse else dr.maximum(value - self._diffuse(si, wo, active), 0)

    def pdf(
        self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: Any = True
    ) -> mi.Float:
        """Density of :meth:`sample`, 1/sr, (N,)."""
        diffuse, rest = _enabled(ctx)
        if not rest:
            there = mi.Vector3f(wo.x, wo.y, dr.abs(wo.z))
            density = mi.warp.square_to_cosine_hemisphere_pdf(there)
            return dr.select(mi.Bool(active) & diffuse & self._reflects(si, wo), density, 0)
        return (self.whole if diffuse else self.rest).pdf(_all_of(ctx), si, wo, active)

    def eval_pdf(
        self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: Any = True
    ) -> tuple[mi.Color3f, mi.Float]:
        """:meth:`eval` and :meth:`pdf` together."""
        return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

    def sample(
        self,
        ctx: mi.BSDFContext,
        si: mi.SurfaceInteraction3f,
        sample1: mi.Float,
        sample2: mi.Point2f,
        active: Any = True,
    ) -> tuple[mi.BSDFSample3f, mi.Color3f]:
        """A direction, and ``f |cos θ_o|`` over its density, (N, 3), for the enabled components."""
        diffuse, rest = _enabled(ctx)
        if rest and diffuse:
            return self.whole.sample(ctx, si, sample1, sample2, active)
        if rest:
            found, weight = self.rest.sample(_all_of(ctx), si, sample1, sample2, active)
            # Samples on the wrong side of the surface have no weight, although they have a density.
            found.pdf = dr.select(dr.max(weight) > 0, found.pdf, 0)
            through = mi.has_flag(found.sampled_type, mi.BSDFFlags.Transmission)
            glossy = mi.BSDFFlags.GlossyTransmission, mi.BSDFFlags.GlossyReflection
            found.sampled_type = dr.select(through, *(mi.UInt32(int(flag)) for flag in glossy))
        else:
            found = dr.zeros(mi.BSDFSample3f)
            found.wo = mi.warp.square_to_cosine_hemisphere(sample2)
            if self.two_sided:
                found.wo.z = dr.mulsign(found.wo.z, si.wi.z)
            found.pdf = self.pdf(ctx, si, found.wo, active)
            found.eta = 1.0
            found.sampled_type = mi.UInt32(int(mi.BSDFFlags.DiffuseReflection))
            found.sampled_component = mi.UInt32(0)
        value = self.eval(ctx, si, found.wo, active)
        return found, dr.select(mi.Bool(active) & (found.pdf > 0), value / found.pdf, 0)

    def eval_diffuse_reflectance(
        self, si: mi.SurfaceInteraction3f, active: Any = True
    ) -> mi.Color3f:
        """The reflectance of Mitsuba's plugin, (N, 3)."""
        return self.whole.eval_diffuse_reflectance(si, active)

    def _reflects(self, si: mi.SurfaceInteraction3f, wo: mi.Vector3f) -> mi.Bool:
        """Whether both directions are on the same side and it has a diffuse component, (N,)."""
        return (si.wi.z * wo.z > 0) & ((wo.z > 0) | self.two_sided)

    def _diffuse(self, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: Any) -> mi.Color3f:
        """D |cos θ_o|, (N, 3)."""
        active = mi.Bool(active) & self._reflects(si, wo)
        taken, transmission, flatness = (
            part.eval_1(si, active) for part in (self.taken, self.transmission, self.flatness)
        )
        share = (1 - self.taken_share * taken) * (1 - transmission) * (1 - 0.375 * flatness)
        cosine = dr.abs(wo.z)
        level = share * _falloff(dr.abs(si.wi.z)) * _falloff(cosine) * cosine / dr.pi
        return dr.select(active, level * self.base_color.eval(si, active), 0)

    def class_name(self) -> str:
        """The name of this class; by default, Mitsuba returns that of its base class."""
        return type(self).__name__

    def to_string(self) -> str:
        """A printable description."""
        return f"{self.class_name()}[{self.whole}]"


class SeparablePrincipled(_Separable):
    """The plugin ``separable_principled``; its properties are those of ``principled``."""

    original, two_sided = "principled", False
    taken_by, taken_share = "metallic", 1.0


class SeparablePrincipledThin(_Separable):
    """The plugin ``separable_principledthin``; its properties are those of ``principledthin``."""

    original, two_sided = "principledthin", True
    taken_by, taken_share = "diff_trans", 0.5


def _falloff(cosine: mi.Float) -> mi.Float:
    """a(w), (N,)."""
    return 1 - 0.5 * (1 - cosine) ** 5


def _enabled(context: mi.BSDFContext) -> tuple[bool, bool]:
    """Whether a context enables the diffuse component, and the rest."""
    mask = int(context.type_mask)
    return bool(mask & int(mi.BSDFFlags.Diffuse)), bool(mask & int(mi.BSDFFlags.Glossy))


def _all_of(context: mi.BSDFContext) -> mi.BSDFContext:
    """A context with all components."""
    return mi.BSDFContext(context.mode)


mi.register_bsdf("separable_principled", SeparablePrincipled)
mi.register_bsdf("separable_principledthin", SeparablePrincipledThin)

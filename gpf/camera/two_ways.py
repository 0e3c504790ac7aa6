"""The two ways of a camera walk from its first surface, and the choice of one of them.

From smooth glass, a ray may be reflected or pass through; from a surface with a diffuse and other
components, it may end or leave. Following both lowers the noise of a picture.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from gpf.core.structs import Way
from gpf.scene.materials import has_diffuse, has_others, is_smooth_glass

OTHER_WAYS = 4
"""Where the other way from a first surface has weight F, a sample takes it with probability
min(1, OTHER_WAYS F): this many times as often as by chance. It then counts for less, which lowers
the noise of the picture, but takes time that could go into more samples."""

LEAST_OF_OTHERS, LEAST_OF_HOLES = 0.0625, 0.25
"""Lower limits of F, in that probability only, for components beside a diffuse one and for holes in
it: a sample of them may be zero by chance although they exist."""


@dataclass
class Fork:
    """Whether a surface is the first, and smooth glass, (N,); or the first, and has a diffuse
    component, (N,)."""

    glass: mi.Bool
    layers: mi.Bool


class RandomWay:
    """Walks that choose one of the ways at random."""

    def start(self) -> Way | None:
        """The way before the first surface; None if it stays the only one, with weight 1."""
        return None

    def sees_light(self, depth: mi.UInt32) -> mi.Bool:
        """Whether the emission of a surface counts, (N,)."""
        return mi.Bool(True)

    def fork(self, bsdf: mi.BSDF, si: mi.SurfaceInteraction3f, depth: mi.UInt32) -> Fork:
        """What kind of fork a surface is."""
        return Fork(mi.Bool(False), mi.Bool(False))

    def goes_on(self, fork: Fork, depth: mi.UInt32) -> mi.Bool:
        """Whether a walk takes this way at all, (N,)."""
        return mi.Bool(True)

    def choice(self, fork: Fork, number: mi.Float) -> mi.Float:
        """The random number that chooses among the components of a BSDF."""
        return number

    def through_glass(
        self, fork: Fork, way: Way, sample: mi.BSDFSample3f, active: mi.Bool
    ) -> tuple[Way, mi.Float]:
        """The way at glass, and the factor for the weight of the BSDF's sample."""
        return way, mi.Float(1)

    def off_layers(
        self, fork: Fork, way: Way, bsdf: mi.BSDF, share: mi.Float, active: mi.Bool
    ) -> tuple[Way, mi.Float]:
        """The way at a diffuse surface, and the probability that the walk ends there, given the
        ``share`` of the diffuse component."""
        return way, share

    def leaves_out_gloss(self, fork: Fork) -> mi.Bool:
        """Whether direct light on glossy components belongs to the other way, (N,)."""
        return mi.Bool(False)


class GivenWay(RandomWay):
    """Walks that go back from their first surface where ``back``, and forward elsewhere, (N,).

    If it is smooth glass with Fresnel reflectance F, rays that go back are reflected, with weight
    F; the others pass through, with weight 1 - F. If it has a diffuse and other components, rays
    that go back leave by the other components; the others end at the diffuse one. At any other
    first surface, and with total reflection, rays that go forward have weight 1, and those that go
    back find nothing. The sum of both ways has the same mean as one way at random.

    Only for scenes for which :func:`gpf.scene.inventory.divides_walks` is true.
    """

    def __init__(self, back: mi.Bool | bool) -> None:
        self.back = mi.Bool(back)

    def start(self) -> Way:
        """With weight 1 for the forward way, which exists everywhere."""
        return Way(dr.select(self.back, mi.Float(0), 1), mi.Float(0))

    def sees_light(self, depth: mi.UInt32) -> mi.Bool:
        """The emission of the first surface counts for the walk that goes forward."""
        return ~self.back | (depth > 0)

    def fork(self, bsdf: mi.BSDF, si: mi.SurfaceInteraction3f, depth: mi.UInt32) -> Fork:
        """Only a first surface is one."""
        first = depth == 0
        return Fork(first & is_smooth_glass(bsdf), first & has_diffuse(bsdf, si))

    def goes_on(self, fork: Fork, depth: mi.UInt32) -> mi.Bool:
        """There is a way back from a fork."""
        return ~self.back | fork.glass | fork.layers | (depth > 0)

    def choice(self, fork: Fork, number: mi.Float) -> mi.Float:
        """Zero chooses reflection, one refraction."""
        towards = dr.select(self.back, mi.Float(0), dr.one_minus_epsilon(mi.Float))
        return dr.select(fork.glass, towards, number)

    def through_glass(
        self, fork: Fork, way: Way, sample: mi.BSDFSample3f, active: mi.Bool
    ) -> tuple[Way, mi.Float]:
        """The density of one of two directions is its probability; for total reflection, 1."""
        chosen = dr.select(self.back & (sample.pdf >= 1), 0, sample.pdf)
        here = fork.glass & active
        weight = dr.select(here, chosen, way.weight)
        chance = dr.select(here, _chance(1 - chosen), way.chance)
        return Way(weight, chance), dr.select(fork.glass, chosen, 1)

    def off_layers(
        self, fork: Fork, way: Way, bsdf: mi.BSDF, share: mi.Float, active: mi.Bool
    ) -> tuple[Way, mi.Float]:
        """The forward way ends at the diffuse component."""
        here = fork.layers & active
        weight = dr.select(here, dr.select(self.back, 1 - share, share), way.weight)
        masked = mi.has_flag(bsdf.flags(), mi.BSDFFlags.Null)
        least = dr.select(masked, mi.Float(LEAST_OF_HOLES), LEAST_OF_OTHERS)
        more = _chance(dr.maximum(1 - share, least))
        chance = dr.select(here & has_others(bsdf), more, way.chance)
        ends = dr.select(here, dr.select(self.back, mi.Float(0), 1), share)
        return Way(weight, chance), ends

    def leaves_out_gloss(self, fork: Fork) -> mi.Bool:
        """It belongs to the way back."""
        return fork.layers & ~self.back


def _chance(other: mi.Float) -> mi.Float:
    """Probability of taking the other way, (N,), if it has weight ``other``."""
    return dr.minimum(OTHER_WAYS * other, 1)

"""Sets of emitters, and samples of their direct light."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from functools import cached_property

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.errors import UserError
from gpf.core.loops import loops_traced_once
from gpf.core.structs import from_numpy
from gpf.scene.materials import has_null
from gpf.scene.media import Media

# A sample of direct light uses at most this many emitters, picked at random if there are more.
MOST_AT_ONCE = 4


class Lamps:
    """Some of the emitters of a scene.

    Parameters
    ----------
    indices: indices of the emitters in ``scene.emitters()``, possibly none; all by default, as
        often as their ``sampling_weight`` says. If that of one is 0, which leaves its light to
        rays that meet it by chance, all are sampled equally often.
    through_null: whether their light also passes through surfaces that do not bend it, such as
        cloth with holes or a thin pane of glass (Mitsuba's flag ``Null``). As in ``volpath``, such
        surfaces do not count towards a depth limit.

    Raises
    ------
    UserError: the scene has no emitter with one of these indices.
    """

    def __init__(
        self,
        scene: mi.Scene,
        indices: Sequence[int] | None = None,
        through_null: bool = True,
    ) -> None:
        count = len(scene.emitters())
        if indices and not all(0 <= k < count for k in indices):
            raise UserError(
                "field",
                f"names emitters {list(indices)}, but the scene has {count}",
                "Use a field that was fitted to this scene; in params.yaml, correct field.direct.",
            )
        self.scene, self.indices, self._through_null = scene, indices, through_null
        self._index = mi.UInt32(list(indices)) if indices else mi.UInt32(0)
        self._count = count if indices is None else len(indices)
        weighted = all(emitter.sampling_weight() > 0 for emitter in scene.emitters())
        self._as_mitsuba = indices is None and weighted
        self._groups: list[Lamps] | None = None

    def sample(
        self,
        origin: mi.Interaction3f,
        sample: mi.Point2f,
        active: mi.Bool,
        medium: mi.MediumPtr | None = None,
    ) -> tuple[mi.DirectionSample3f, mi.Color3f]:
        """Sample a point on one of the emitters, as ``scene.sample_emitter_direction`` does.

        Returns the point, with a density of zero if it is hidden, and its radiance divided by the
        density of its direction, times the fraction that arrives, W/m² for a cosine of one, (N, 3).

        ``medium``: what is around the origins, if that is known.
        """
        light, weight = self.choose(origin, sample, active)
        seen = active & (light.pdf > 0)
        if self._asks_null:
            ray = origin.spawn_ray_to(light.p)
            if medium is None and self._media.there:
                medium = self._media.around(ray, seen)
            with dr.suspend_grad():  # what is in between counts as fixed
                share = self._arriving_share(ray, light.p, sample.x, seen, medium)
            weight *= share
            seen &= dr.any(share > 0)
        else:
            seen &= ~self.scene.ray_test(origin.spawn_ray_to(light.p), seen)
        light.pdf = dr.select(seen, light.pdf, 0)
        return light, dr.select(seen, weight, 0)

    @loops_traced_once
    @dr.syntax
    def _arriving_share(  # type: ignore[no-untyped-def]
        self, ray, target, random, active, medium
    ) -> mi.Color3f:
        """The fraction of light from points that goes straight to the origins of rays, (N, 3)."""
        share, walking = dr.select(active, mi.Color3f(1), 0), mi.Bool(active)
        if dr.hint(not self._media.there, mode="scalar"):
            medium = mi.UInt32(0)
        while dr.hint(walking, exclude=[target, random]):
            si = self.scene.ray_intersect(ray, active=walking)
            if dr.hint(self._media.there, mode="scalar"):
                distance = dr.minimum(si.t, ray.maxt)
                share *= self._media.transmittance(medium, ray, distance, random, walking)
                crossing = walking & si.is_medium_transition()
                medium = dr.select(crossing, si.target_medium(ray.d), medium)
            walking &= si.is_valid()
            through = mi.Color3f(0)
            if dr.hint(self._through_null, mode="scalar"):
                through = si.bsdf(ray).eval_null_transmission(si, walking)
            share *= dr.select(walking, through, 1)
            walking &= dr.any(share > 0)
            ray = si.spawn_ray_to(target)
        return share

    @cached_property
    def _asks_null(self) -> bool:
        return self._media.there or (self._through_null and has_null(self.scene))

    @cached_property
    def _media(self) -> Media:
        return Media(self.scene)

    def choose(
        self, origin: mi.Interaction3f, sample: mi.Point2f, active: mi.Bool
    ) -> tuple[mi.DirectionSample3f, mi.Color3f]:
        """Like :meth:`sample`, but without visibility."""
        if self._as_mitsuba:
            return self.scene.sample_emitter_direction(origin, sample, False, active)
        if not self:
            return dr.zeros(mi.DirectionSample3f), mi.Color3f(0)
        emitter, rest = self._pick(sample.x, active)
        light, weight = emitter.sample_direction(origin, mi.Point2f(rest, sample.y), active)
        light.pdf /= self._count
        return light, weight * self._count

    def _pick(self, number: mi.Float, active: mi.Bool) -> tuple[mi.EmitterPtr, mi.Float]:
        """One of the emitters, (N,), and what is left of the random number, in [0, 1)."""
        place = number * self._count
        k = dr.minimum(mi.UInt32(place), self._count - 1)
        chosen = k if self.indices is None else dr.gather(mi.UInt32, self._index, k, active)
        emitter = dr.gather(mi.EmitterPtr, self.scene.emitters_dr(), chosen, active)
        return emitter, place - mi.Float(k)

    def density(
        self, origin: mi.Interaction3f, light: mi.DirectionSample3f, active: mi.Bool
    ) -> mi.Float:
        """The density with which :meth:`sample` finds a point on one of them, 1/sr, (N,)."""
        if self._as_mitsuba:
            return self.scene.pdf_emitter_direction(origin, light, active)
        return light.emitter.pdf_direction(origin, light, active) / self._count

    @cached_property
    def can_be_near(self) -> bool:
        """Whether some have a size, so that rays may meet them near by. Not where there are media,
        for :meth:`met` knows none."""
        _ = self._table  # cannot be computed within a loop
        return not self._media.there and self.size > 0

    @cached_property
    def size(self) -> float:
        """The diagonal of the largest that has one, world units, or 0."""
        sizes = {s.emitter(): float(dr.norm(s.bbox().extents())) for s in self.scene.shapes()}
        emitters = self.scene.emitters()
        chosen = emitters if self.indices is None else [emitters[k] for k in self.indices]
        return max((sizes.get(each, 0.0) for each in chosen), default=0.0)

    @loops_traced_once
    @dr.syntax
    def met(  # type: ignore[no-untyped-def]
        self, origin, ray, pdf, samples, active
    ) -> mi.Color3f:
        """Radiance of these lamps that rays meet straight on, W/(m² sr), (N, 3): its share in a
        mean with ``samples`` times as many results of :meth:`sample` (balance heuristic).

        ``pdf``: of the rays, 1/sr, (N,).
        """
        found, through = mi.Color3f(0), mi.Color3f(1)
        walking = mi.Bool(active)
        while dr.hint(walking, exclude=[origin, pdf]):
            si = self.scene.ray_intersect(ray, active=walking)
            emitter = si.emitter(self.scene)
            # A ray that ends in mid-air has not met the sky.
            lit = walking & self._holds(emitter) & (si.is_valid() | (ray.maxt > 1e30))
            other = self.density(origin, mi.DirectionSample3f(self.scene, si, origin), lit)
            share = dr.select(lit, pdf / (pdf + samples * other), 0)
            found += through * share * emitter.eval(si, lit)
            walking &= si.is_valid()
            passing = mi.Color3f(0)
            if dr.hint(self._asks_null, mode="scalar"):
                passing = si.bsdf(ray).eval_null_transmission(si, walking)
            through *= passing
            walking &= dr.any(through > 0)
            ray = si.spawn_ray(ray.d)
        return found

    def _holds(self, emitter: mi.EmitterPtr) -> mi.Bool:
        """Whether an emitter is one of these, (N,)."""
        if self.indices is None:
            return emitter != dr.zeros(mi.EmitterPtr)
        which = dr.reinterpret_array(mi.UInt32, emitter)
        return dr.gather(mi.UInt32, self._table, which, which < dr.width(self._table)) > 0

    @cached_property
    def _table(self) -> mi.UInt32:
        """1 for each of these, by the number of its pointer."""
        pointers = np.array(dr.reinterpret_array(mi.UInt32, self.scene.emitters_dr()))
        table = np.zeros(pointers.max(initial=0) + 1, np.uint32)
        table[pointers[list(self.indices or ())]] = 1
        return from_numpy(mi.UInt32, table)

    def emit(
        self, choice: mi.Float, place: mi.Point2f, direction: mi.Point2f
    ) -> tuple[mi.Ray3f, mi.Color3f, mi.EmitterPtr]:
        """Rays from random numbers in [0, 1), their powers, W, and their emitters, (N,) each."""
        if self._as_mitsuba:
            return self.scene.sample_emitter_ray(0, choice, place, direction, True)
        emitter, rest = self._pick(choice, mi.Bool(True))
        ray, power = emitter.sample_ray(0, rest, place, direction, True)
        return ray, power * self._count, emitter

    def others(self) -> Lamps:
        """All emitters except these."""
        if not self:
            return self._with(None)
        every = range(0 if self.indices is None else len(self.scene.emitters()))
        return self._with([k for k in every if k not in (self.indices or ())])

    def _with(self, indices: Sequence[int] | None) -> Lamps:
        """The same, with other emitters."""
        return Lamps(self.scene, indices, self._through_null)

    def __bool__(self) -> bool:
        return self.indices is None or len(self.indices) > 0

    def groups(self) -> list[Lamps]:
        """At most :data:`MOST_AT_ONCE` sets that make up these lamps; all emitters form one set."""
        if self.indices is None:
            return [self]
        if self._groups is None:
            parts = min(len(self.indices), MOST_AT_ONCE)
            self._groups = [self._with(self.indices[k::parts]) for k in range(parts)]
        return self._groups

    def arrays(self) -> list[mi.UInt32]:
        """The arrays that sampling these lamps or their groups reads; see :meth:`with_arrays`."""
        return [self._index, *(group._index for group in self.groups())]

    def with_arrays(self, arrays: Sequence[mi.UInt32]) -> Lamps:
        """The same lamps, which read these arrays, so that a recorded function can take them as
        arguments."""
        if self.indices is None:
            return self
        other = copy.copy(self)
        other._groups = [copy.copy(group) for group in self.groups()]
        for lamps, index in zip([other, *other._groups], arrays, strict=True):
            lamps._index = index
        return other


def small_lamps(scene: mi.Scene, length: float) -> list[int]:
    """The emitters without a size, or smaller than ``length`` (world units), as indices into
    ``scene.emitters()``.

    Their shadows are too sharp for a field, and sampling them causes little noise.
    """
    sizes = {s.emitter(): float(dr.norm(s.bbox().extents())) for s in scene.shapes()}
    return [k for k, e in enumerate(scene.emitters()) if _size(e, sizes) < length]


def _size(emitter: mi.Emitter, sizes: Mapping[mi.Emitter | None, float]) -> float:
    """Diagonal of an emitter, world units; infinite if sampling points on it is useless."""
    position, direction = (
        mi.has_flag(emitter.flags(), flag)
        for flag in (mi.EmitterFlags.DeltaPosition, mi.EmitterFlags.DeltaDirection)
    )
    if mi.has_flag(emitter.flags(), mi.EmitterFlags.Surface):
        # A sampled point of a beam does not emit towards the points that the beam lights.
        return math.inf if direction else sizes.get(emitter, math.inf)
    return 0.0 if position or direction else math.inf

"""Camera walks, and what the field answers where they end.

:class:`Walks` traces everything into one kernel, which can be recorded. :class:`GroupedWalks` is
for many samples of each pixel: what the walks find goes through memory, further walks are made for
those samples alone that need them, and samples close together share a query of the field.
"""

from __future__ import annotations

import operator
from typing import Any

import drjit as dr
import mitsuba as mi

from gpf.camera.film import meets_gloss
from gpf.camera.visible_points import Side, follow
from gpf.core.structs import VisiblePoints
from gpf.field.field import GaussianPhotonField
from gpf.rendering.aovs import at_visible_point

GROUP = 4
"""Most samples of a pixel that share a query."""

NEAR = 0.125
"""Largest distance between samples that share a query, in search radii of their level."""

SAME_SIDE = 0.95
"""Least cosine between their normals."""

FAINT = 0.2
"""Weight of reflections below which the samples of a group share one."""

# How the values of further walks join those of the first; all others are added.
_JOIN = {"valid": operator.or_, "coverage": dr.maximum}


def _join(found: dict[str, Any], further: dict[str, Any]) -> dict[str, Any]:
    return {key: _JOIN.get(key, operator.add)(found[key], further[key]) for key in found}


def _add(found: dict[str, Any], further: dict[str, Any], share: mi.Float) -> dict[str, Any]:
    """The sum of two parts; ``valid`` is that of the first if its share is at least a half."""
    valid = dr.select(share >= 0.5, found["valid"], further["valid"])
    return {key: valid if key == "valid" else v + further[key] for key, v in found.items()}


def _mean(found: dict[str, Any], walks: mi.UInt32) -> dict[str, Any]:
    number = mi.Float(walks)
    return {key: value if key in _JOIN else value / number for key, value in found.items()}


class Walks:
    """The walks of camera samples.

    No dataclass, because Dr.Jit would take it for a part of the state of its loops.

    Parameters
    ----------
    aovs: names of the AOVs (:mod:`gpf.rendering.aovs`).
    max_depth, rr_depth: as of :func:`gpf.camera.visible_points.follow`.
    number: of walks of a sample that meets a glossy surface first.
    divides: whether samples see both what is behind smooth glass and what it reflects
        (:func:`gpf.scene.inventory.divides_glass`).
    """

    def __init__(
        self,
        scene: mi.Scene,
        field: GaussianPhotonField,
        aovs: tuple[str, ...],
        max_depth: int,
        rr_depth: int,
        number: int,
        divides: bool,
    ) -> None:
        self.scene, self.field, self.aovs = scene, field, aovs
        self.max_depth, self.rr_depth = max_depth, rr_depth
        self.number, self.divides = number, divides

    def look(self, sampler: mi.Sampler, ray: mi.Ray3f, active: mi.Bool) -> dict[str, Any]:
        """What rays find: ``radiance``, (N, 3), whether they end on a diffuse surface, ``valid``,
        (N,), and the AOVs of the visible points."""
        found, share = self._walk(sampler, ray, active, "through" if self.divides else "either")
        if self.divides:
            found = self._reflect(sampler, ray, active & (share < 1), share, found)
        if self.number > 1:
            found = self._repeat(sampler, ray, active, found)
        return found

    def _walk(
        self, sampler: mi.Sampler, ray: mi.Ray3f, active: mi.Bool, side: Side = "either"
    ) -> tuple[dict[str, Any], mi.Float]:
        """What one camera walk finds, and the weight of its side, (N,)."""
        points, share = self._follow(sampler, ray, active, side)
        value, reach = self.field.query(points.p, points.n, points.valid)
        return self._shown(points, value, reach, share), share

    def _follow(
        self, sampler: mi.Sampler, ray: mi.Ray3f, active: mi.Bool, side: Side
    ) -> tuple[VisiblePoints, mi.Float]:
        lamps = self.field.settings.sampled_lamps(self.scene)
        depths = self.max_depth, self.rr_depth
        return follow(self.scene, sampler, ray, *depths, active, lamps, side)

    def _shown(
        self, points: VisiblePoints, value: mi.Color3f, reach: mi.Float, share: mi.Float
    ) -> dict[str, Any]:
        found = {"radiance": self.field.reflect(points, value), "valid": points.valid}
        return found | at_visible_point(self.field, points, value, reach, share, self.aovs)

    @dr.syntax
    def _reflect(self, sampler, ray, active, share, found):  # type: ignore[no-untyped-def]
        """The sum of what was found through smooth glass and what it reflects."""
        if active:
            further, _ = self._walk(sampler, ray, active, "back")
            found = _add(found, further, share)
        return found

    @dr.syntax
    def _repeat(self, sampler, ray, active, found):  # type: ignore[no-untyped-def]
        """The mean over several walks for rays whose first surface is glossy; of ``coverage``, the
        largest value."""
        again = meets_gloss(self.scene, ray, active)
        walks = dr.opaque(mi.UInt32, self.number)
        n = mi.UInt32(1)
        while again & (n < walks):
            further, _ = self._walk(sampler, ray, again)
            found = _join(found, further)
            n += 1
        return _mean(found, n)


class GroupedWalks(Walks):
    """The walks of several samples of each pixel, which share what costs most.

    Up to :data:`GROUP` consecutive lanes of the same pixel are a group. Samples of a group are
    exchangeable, so one of them may stand for others without an error of the mean. Those that lie
    close to the first take its answer; the mean then changes only by the covariance, within a
    group, of irradiance and reflectance. Where glass reflects little, they take its reflection.

    Parameters
    ----------
    samples: of each pixel, in consecutive lanes.
    """

    def __init__(self, walks: Walks, samples: int) -> None:
        vars(self).update(vars(walks))
        self.group = max(n for n in range(1, GROUP + 1) if samples % n == 0)

    def look(self, sampler: mi.Sampler, ray: mi.Ray3f, active: mi.Bool) -> dict[str, Any]:
        """As of every walk; the rays go through memory, too."""
        sampler.schedule_state()
        dr.eval(ray)
        return super().look(sampler, ray, active)

    def _walk(
        self, sampler: mi.Sampler, ray: mi.Ray3f, active: mi.Bool, side: Side = "either"
    ) -> tuple[dict[str, Any], mi.Float]:
        points, share = self._follow(sampler, ray, active, side)
        sampler.schedule_state()
        dr.eval(points, share)
        value, reach = query_together(self.field, points, self.group)
        return self._shown(points, value, reach, share), share

    def _reflect(self, sampler, ray, active, share, found):  # type: ignore[no-untyped-def]
        lanes, first = _groups(active, self.group)
        faint = active & (share > 1 - FAINT)
        shared = (lanes != first) & faint & dr.gather(mi.Bool, faint, first)
        further = self._walk_some(sampler, ray, active & ~shared, first, active, "back")
        return _add(found, further, share) if further else found

    def _repeat(self, sampler, ray, active, found):  # type: ignore[no-untyped-def]
        again = meets_gloss(self.scene, ray, active)
        lanes, _ = _groups(again, 1)
        for _ in range(1, self.number):
            further = self._walk_some(sampler, ray, again, lanes, again, "either")
            if not further:
                return found
            found = _join(found, further)
        return _mean(found, dr.select(again, mi.UInt32(self.number), 1))

    def _walk_some(  # type: ignore[no-untyped-def]
        self, sampler, ray, asks, first, active, side: Side
    ) -> dict[str, Any]:
        """What the rays of the lanes that ask find, and others get from their first; zeros where
        not active. Empty if no lane asks."""
        asking, index = _shared(asks, first)
        count = dr.width(asking)
        if count == 0:
            return {}
        # Mitsuba cannot take some lanes of a sampler.
        own = mi.load_dict({"type": "independent"})
        own.seed(int(dr.slice(sampler.next_1d(), 0) * (1 << 24)), count)
        parts = (ray.o, ray.d, ray.maxt, ray.time, ray.wavelengths)
        some = mi.Ray3f(*(dr.gather(type(v), v, asking) if dr.width(v) > 1 else v for v in parts))
        alone = GroupedWalks(self, 1)
        found, _ = alone._walk(own, some, dr.full(mi.Bool, True, count), side)
        dr.eval(found)
        return {key: _answer(value, index, active) for key, value in found.items()}


def query_together(
    field: GaussianPhotonField, points: VisiblePoints, group: int
) -> tuple[mi.Color3f, mi.Float]:
    """The field's answer at evaluated points, as of :meth:`GaussianPhotonField.query`.

    Lanes ask only where their walk found a diffuse surface, and where the first lane of their group
    does not ask for them.

    Parameters
    ----------
    group: number of lanes of a group; 1 if no lane asks for another one.
    """
    lanes, first = _groups(points.valid, group)
    x = field.unfold(points.p)
    apart = dr.squared_norm(x - dr.gather(mi.Point3f, x, first))
    shared = (lanes != first) & dr.gather(mi.Bool, points.valid, first)
    shared &= apart < (NEAR * field.settings.search_radius) ** 2
    shared &= dr.dot(points.n, dr.gather(mi.Normal3f, points.n, first)) > SAME_SIDE
    asking, index = _shared(points.valid & ~shared, first)
    if dr.width(asking) == 0:
        return mi.Color3f(0), mi.Float(dr.inf)
    p, n = dr.gather(mi.Point3f, points.p, asking), dr.gather(mi.Normal3f, points.n, asking)
    value, reach = field.query(p, n, mi.Bool(True))
    dr.eval(value, reach)
    reach = dr.select(points.valid, _answer(reach, index, points.valid), dr.inf)
    return _answer(value, index, points.valid), reach


def _groups(lanes: mi.Bool, group: int) -> tuple[mi.UInt32, mi.UInt32]:
    """The numbers of lanes, and those of the first lanes of their groups, (N,) each."""
    number = dr.arange(mi.UInt32, dr.width(lanes))
    return number, number - number % group


def _shared(asks: mi.Bool, first: mi.UInt32) -> tuple[mi.UInt32, mi.UInt32]:
    """The lanes that ask, (M,), and whose answer each lane gets, (N,): its own if it asks, or that
    of the first lane of its group."""
    place = dr.prefix_reduce(dr.ReduceOp.Add, dr.select(asks, mi.UInt32(1), 0), exclusive=True)
    dr.eval(asks, place)
    return dr.compress(asks), dr.select(asks, place, dr.gather(mi.UInt32, place, first))


def _answer(values: Any, index: mi.UInt32, active: mi.Bool) -> Any:
    """The answers of lanes, zero where not active; what is the same for all has a single lane."""
    if dr.width(values) == 1:
        return dr.select(active, values, dr.zeros(type(values)))
    return dr.gather(type(values), values, index, active)

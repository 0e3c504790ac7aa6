"""Camera walks, and the field's answers where they end.

:class:`Walks` traces everything into one kernel, which can be recorded. :class:`GroupedWalks` is
for many samples per pixel: what the walks find goes through memory, further walks are made only for
the samples that need them, and samples close together share an answer of the field.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi

from gpf.camera.haze import lit_by
from gpf.camera.recorded_steps import RecordedSteps, Step
from gpf.camera.visible_points import follow, walk
from gpf.core.structs import Haze, VisiblePoints, Way, take
from gpf.field.field import GaussianPhotonField
from gpf.field.gathering import light_at
from gpf.field.shared_query import NEAR, in_order, query_shared
from gpf.rendering.aovs import at_visible_point
from gpf.scene.lamps import Lamps
from gpf.sppm.fixed_points import FixedPoints

NEAR_IN_REFLECTIONS = 0.1
"""What is seen in glass or lacquer is faint, or blurred: there, points may share an answer that are
so many search radii apart."""


class Walks:
    """The walks of camera samples.

    Not a dataclass, because Dr.Jit would take it for a part of the state of its loops.

    Parameters
    ----------
    aovs: names of the AOVs (:mod:`gpf.rendering.aovs`).
    max_depth, rr_depth: as in :func:`gpf.camera.visible_points.follow`.
    divides: whether samples may take both ways at their first surface
        (:func:`gpf.scene.inventory.divides_walks`).
    """

    def __init__(
        self,
        scene: mi.Scene,
        field: GaussianPhotonField,
        aovs: tuple[str, ...],
        max_depth: int,
        rr_depth: int,
        divides: bool,
    ) -> None:
        self.scene, self.field, self.aovs = scene, field, aovs
        self.max_depth, self.rr_depth = max_depth, rr_depth
        self.divides = divides

    @dr.syntax
    def look(self, sampler, ray, active):  # type: ignore[no-untyped-def]
        """What rays find: ``radiance``, (N, 3), whether surfaces end or turn them, ``valid``,
        (N,), and the AOVs of the visible points.

        At the first surface, this is the sum of what is behind smooth glass and what it reflects,
        or of a diffuse component and the others.
        """
        if dr.hint(not self.divides, mode="scalar"):
            return self._walk(sampler, ray, active, mi.Bool(False))[0]
        found = self._nothing()
        through, weight = mi.Float(0), mi.Float(1)
        back = mi.Bool(False)
        walking = mi.Bool(active)
        while dr.hint(walking, exclude=[ray]):
            further, way = self._walk(sampler, ray, walking, back)
            found = _join(found, further, through, weight)
            through = mi.Float(way.weight)
            back = ~back & (sampler.next_1d(walking) < way.chance)
            weight = 1 / way.chance
            walking &= back
        return found

    def _walk(
        self, sampler: mi.Sampler, ray: mi.Ray3f, active: mi.Bool, back: mi.Bool
    ) -> tuple[dict[str, Any], Way]:
        """What one camera walk finds, and which way it took."""
        points, way, unsure = self._follow(sampler, ray, active, back)
        value, reach = self.field.query(points.p, points.n, points.valid)
        return self._shown(points, value, reach, way, unsure, sampler), way

    def _follow(
        self, sampler: mi.Sampler, ray: mi.Ray3f, active: mi.Bool, back: mi.Bool | bool
    ) -> tuple[VisiblePoints, Way, mi.Color3f]:
        """The visible points, whose emission includes the light of media, the way to them, and the
        expected error of that light."""
        lamps = self.field.settings.sampled_lamps(self.scene)
        depths = self.max_depth, self.rr_depth
        side = back if self.divides else None
        points, way, haze = self._run(_followed, sampler, [lamps], ray, active, side, depths)
        unsure = mi.Color3f(0)
        if (volume := self.field.volume) is not None:
            lamps = volume.fluence.settings.sampled_lamps(self.scene)
            light = self._scattered(haze) + lit_by(lamps, haze, sampler)
            points.emission += haze.radiance(light)
            if "error" in self.aovs:
                unsure = haze.radiance(volume.error(haze))
        return points, way, unsure

    def _run(self, step: Step, sampler: mi.Sampler, *arguments: Any) -> Any:
        """What a step of the walks finds (:mod:`gpf.camera.recorded_steps`)."""
        return step(self.scene, sampler, *arguments)

    def _scattered(self, haze: Haze) -> mi.Color3f:
        """The field's answer at places in media."""
        found: mi.Color3f = self.field.volume.scattered(haze)
        return found

    def _shown(
        self,
        points: VisiblePoints,
        value: mi.Color3f,
        reach: mi.Float,
        way: Way,
        unsure: mi.Color3f,
        sampler: mi.Sampler | None = None,
    ) -> dict[str, Any]:
        found = {"radiance": self.field.reflect(points, value), "valid": points.opaque()}
        sampled = mi.Color3f(0)
        if sampler is not None and "irradiance" in self.aovs:
            here = FixedPoints(self.scene, points, lasting=False)
            for group in self.field.settings.sampled_lamps(self.scene).groups():
                sampled += here.direct_irradiance(sampler.next_2d(points.valid), group)
        answer = value, sampled, reach, way.weight, unsure
        return found | at_visible_point(self.field, points, *answer, self.aovs)

    def _nothing(self) -> dict[str, Any]:
        points, black = dr.zeros(VisiblePoints), mi.Color3f(0)
        shown = self._shown(points, black, mi.Float(0), dr.zeros(Way), black)
        return {key: dr.zeros(type(value)) for key, value in shown.items()}


def _join(
    found: dict[str, Any], further: dict[str, Any], through: mi.Float, weight: mi.Float
) -> dict[str, Any]:
    """The sum of both ways from a first surface; ``valid`` is that of the way with the greater
    weight.

    Parameters
    ----------
    through: weight of the first way, (N,).
    weight: factor for the second way, (N,).
    """
    # Dr.Jit's loops need the same order of keys each time.
    joined = {k: v if k == "valid" else v + weight * further[k] for k, v in found.items()}
    joined["valid"] = dr.select(through >= 0.5, found["valid"], further["valid"])
    return joined


class GroupedWalks(Walks):
    """Walks that share what costs most (:mod:`gpf.field.shared_query`).

    Parameters
    ----------
    steps: recorded steps of walks in the scene.
    near: how close points are that share an answer, in search radii.
    """

    def __init__(self, walks: Walks, steps: RecordedSteps, near: float = NEAR) -> None:
        vars(self).update(vars(walks))
        self.near, self.steps = near, steps

    def look(self, sampler: mi.Sampler, ray: mi.Ray3f, active: mi.Bool) -> dict[str, Any]:
        """As for all walks; the rays go through memory, too."""
        sampler.schedule_state()
        dr.eval(ray)
        found, way = self._walk(sampler, ray, active, mi.Bool(False))
        if self.divides:
            back = active & (sampler.next_1d(active) < way.chance)
            further = self._walk_back(sampler, ray, back)
            if further:
                found = _join(found, further, way.weight, dr.select(back, 1 / way.chance, 0))
        return found

    def _walk(
        self, sampler: mi.Sampler, ray: mi.Ray3f, active: mi.Bool, back: mi.Bool
    ) -> tuple[dict[str, Any], Way]:
        points, way, unsure = self._follow(sampler, ray, active, back)
        value, reach = query_shared(self.field, points.p, points.n, points.valid, self.near)
        return self._shown(points, value, reach, way, unsure, sampler), way

    def _run(self, step: Step, sampler: mi.Sampler, *arguments: Any) -> Any:
        return self.steps.run(step, self.scene, sampler, *arguments)

    def _scattered(self, haze: Haze) -> mi.Color3f:
        asking, fluence = dr.compress(haze.valid), self.field.volume.fluence
        found = dr.zeros(mi.Color3f, dr.width(haze.valid))
        if dr.width(asking) > 0:
            nowhere = dr.zeros(mi.Normal3f, dr.width(haze.valid))
            asking = in_order(fluence, haze.p, nowhere, asking)
            dr.scatter(found, super()._scattered(take(haze, asking)), asking)
        return found

    def _walk_back(  # type: ignore[no-untyped-def]
        self, sampler, ray, back
    ) -> dict[str, Any]:
        """What rays find the second way: zeros where not ``back``, empty if no ray takes it."""
        asking, index = _compressed(back)
        count = dr.width(asking)
        if count == 0:
            return {}
        # Mitsuba cannot select some lanes of a sampler.
        own = mi.load_dict({"type": "independent"})
        own.seed(mi.UInt32(dr.gather(mi.Float, sampler.next_1d(), 0) * (1 << 24)), count)
        parts = (ray.o, ray.d, ray.maxt, ray.time, ray.wavelengths)
        some = mi.Ray3f(*(dr.gather(type(v), v, asking) if dr.width(v) > 1 else v for v in parts))
        alone = GroupedWalks(self, self.steps, NEAR_IN_REFLECTIONS)
        found, _ = alone._walk(own, some, dr.full(mi.Bool, True, count), mi.Bool(True))
        dr.eval(found)
        return {key: _answer(value, index, back) for key, value in found.items()}


class GatheredWalks(GroupedWalks):
    """Walks at whose ends light is gathered (:mod:`gpf.field.gathering`); only caustics are the
    field's, and what glass and lacquer reflect (:data:`NEAR_IN_REFLECTIONS`)."""

    def _walk(
        self, sampler: mi.Sampler, ray: mi.Ray3f, active: mi.Bool, back: mi.Bool
    ) -> tuple[dict[str, Any], Way]:
        depths, side = (self.max_depth, self.rr_depth), back if self.divides else None
        lamps: list[Lamps] = []  # they are sampled where light is gathered
        more = ray, active, side, depths
        points, way, last = self._run(_walk_to_surface, sampler, lamps, *more)
        found = light_at(self.scene, self.field, sampler, last, points.valid, self.steps.run)
        points.emission += dr.select(points.valid, points.throughput * found, 0)
        caustics = self.field.part("caustics")
        value, reach = query_shared(caustics, points.p, points.n, points.valid, self.near)
        return self._shown(points, value, reach, way, mi.Color3f(0), sampler), way


def _followed(
    scene: mi.Scene,
    sampler: mi.Sampler,
    lamps: Sequence[Lamps],
    ray: mi.Ray3f,
    active: mi.Bool,
    back: mi.Bool | None,
    depths: tuple[int, int],
) -> tuple[VisiblePoints, Way, Haze]:
    return follow(scene, sampler, ray, *depths, active, lamps[0], back)


def _walk_to_surface(
    scene: mi.Scene,
    sampler: mi.Sampler,
    lamps: Sequence[Lamps],
    ray: mi.Ray3f,
    active: mi.Bool,
    back: mi.Bool | None,
    depths: tuple[int, int],
) -> tuple[VisiblePoints, Way, mi.Ray3f]:
    """The visible points, the ways to them, and the rays that meet them."""
    points, way, _, arrival = walk(scene, sampler, ray, *depths, active, None, back)
    return points, way, arrival.ray


def _compressed(asks: mi.Bool) -> tuple[mi.UInt32, mi.UInt32]:
    """The lanes that ask, (M,), and the place of each lane among them if it asks, (N,)."""
    place = dr.prefix_reduce(dr.ReduceOp.Add, dr.select(asks, mi.UInt32(1), 0), exclusive=True)
    dr.eval(asks, place)
    return dr.compress(asks), place


def _answer(values: Any, index: mi.UInt32, active: mi.Bool) -> Any:
    """The answers of lanes, zero where not active; a value with one lane is the same for all."""
    if dr.width(values) == 1:
        return dr.select(active, values, dr.zeros(type(values)))
    return dr.gather(type(values), values, index, active)

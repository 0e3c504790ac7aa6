"""Emission: the first rays of photon paths."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.scene.bounds import bounding_box
from gpf.scene.lamps import Lamps

# Makes one ray per lane of the sampler's wavefront, with its power, W, and its emitter. The
# expected power of a ray is that of all emitters together.
Emitted = tuple["mi.Ray3f", "mi.Color3f", "mi.EmitterPtr"]
Source = Callable[["mi.Scene", "mi.Sampler"], Emitted]


@dataclass
class EmitterSample:
    """The five uniform random numbers in [0, 1) that determine an emitted ray, (N,) each."""

    choice: mi.Float
    place: mi.Point2f
    direction: mi.Point2f

    @classmethod
    def draw(cls, sampler: mi.Sampler) -> EmitterSample:
        """The next numbers of a sampler."""
        return cls(sampler.next_1d(), sampler.next_2d(), sampler.next_2d())

    @classmethod
    def of(cls, numbers: Sequence[mi.Float]) -> EmitterSample:
        """A sample from five numbers, in the order of :meth:`numbers`."""
        return cls(numbers[0], mi.Point2f(*numbers[1:3]), mi.Point2f(*numbers[3:5]))

    def numbers(self) -> list[mi.Float]:
        """The five numbers: choice, place (2), direction (2)."""
        return [self.choice, *self.place, *self.direction]


def emit_light(scene: mi.Scene, sampler: mi.Sampler) -> Emitted:
    """Rays from the emitters of the scene, their powers, W, and their emitters: (N,) each."""
    return emit_from(scene, EmitterSample.draw(sampler))


def emit_from(scene: mi.Scene, start: EmitterSample) -> Emitted:
    """The rays that these random numbers determine, their powers, W, and emitters: (N,) each."""
    ray, power, emitter = Lamps(scene).emit(start.choice, start.place, start.direction)
    if any(mi.has_flag(each.flags(), mi.EmitterFlags.Infinite) for each in scene.emitters()):
        power *= _spread_over_scene(scene, ray, emitter, start.place)
    return ray, power, emitter


def _spread_over_scene(
    scene: mi.Scene, ray: mi.Ray3f, emitter: mi.EmitterPtr, sample: mi.Point2f
) -> mi.Float:
    """Let the rays from infinitely far emitters begin on discs as wide as the scene, perpendicular
    to them; returns the factors for the powers of all rays, (N,).

    Mitsuba's discs are too small where it has merged shapes (:mod:`gpf.scene.bounds`), and in
    version 3.9, for a rotated map, they are perpendicular to another direction.
    """
    lower, upper = bounding_box(scene)
    middle, half = (lower + upper) / 2, np.linalg.norm(upper - lower) / 2
    box, least = scene.bbox(), mi.math.RayEpsilon
    theirs = box.bounding_sphere() if box.valid() else mi.ScalarBoundingSphere3f()
    radii = [max(r * (1 + least), least) for r in (theirs.radius, half)]
    before, radius = (dr.opaque(mi.Float, r) for r in radii)
    around, center = (mi.Point3f(mi.ScalarPoint3f(c)) for c in (theirs.center, middle))
    dr.make_opaque(around, center)

    place = (ray.o - around) / before
    place -= ray.d * dr.dot(ray.d, place)
    sky = scene.environment()
    if sky is not None and sky.class_name() == "EnvironmentMapEmitter":
        disc = mi.warp.square_to_uniform_disk_concentric(sample)
        even = mi.Frame3f(ray.d).to_world(mi.Vector3f(disc.x, disc.y, 0))
        place = dr.select(emitter == mi.EmitterPtr(sky), even, place)
    far = mi.has_flag(emitter.flags(), mi.EmitterFlags.Infinite)
    ray.o = dr.select(far, center + radius * (place - ray.d), ray.o)
    return dr.select(far, dr.square(radius / before), 1)

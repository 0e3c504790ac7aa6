"""Emission: the first rays of photon paths."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

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
    ray, power, emitter = scene.sample_emitter_ray(
        mi.Float(0), start.choice, start.place, start.direction, mi.Bool(True)
    )
    ray.o = _spread_over_scene(scene, ray, emitter, start.place)
    return ray, power, emitter


def _spread_over_scene(
    scene: mi.Scene, ray: mi.Ray3f, emitter: mi.EmitterPtr, sample: mi.Point2f
) -> mi.Point3f:
    """Origins of the rays; for an environment map, on a disc perpendicular to the ray.

    In Mitsuba 3.9 that disc is perpendicular to the direction before ``to_world``, so too many or
    too few rays from a rotated map would hit the scene.
    """
    environment = scene.environment()
    if environment is None or environment.class_name() != "EnvironmentMapEmitter":
        return ray.o
    ball = scene.bbox().bounding_sphere()
    # The emitter's own radius, because its weight contains the area of the disc.
    radius = dr.opaque(mi.Float, ball.radius * (1 + mi.math.RayEpsilon))
    disc = mi.warp.square_to_uniform_disk_concentric(sample)
    offset = mi.Frame3f(ray.d).to_world(mi.Vector3f(disc.x, disc.y, 0)) - ray.d
    center = mi.Point3f(ball.center)
    dr.make_opaque(center)
    origin = center + radius * offset
    return dr.select(emitter == mi.EmitterPtr(environment), origin, ray.o)

"""Emitted rays: the first edges of photon paths."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

# Gives one ray with its power per lane of the sampler's wavefront; the mean of the powers, W, is
# that of all emitters.
Source = Callable[["mi.Scene", "mi.Sampler"], "tuple[mi.Ray3f, mi.Color3f]"]


@dataclass
class EmitterSample:
    """The uniform random numbers in [0, 1) that an emitted ray is made of, (N,) each."""

    choice: mi.Float
    place: mi.Point2f
    direction: mi.Point2f

    @classmethod
    def draw(cls, sampler: mi.Sampler) -> EmitterSample:
        """The next numbers of a sampler."""
        return cls(sampler.next_1d(), sampler.next_2d(), sampler.next_2d())

    @classmethod
    def of(cls, numbers: Sequence[mi.Float]) -> EmitterSample:
        """From five numbers, in the order of :meth:`numbers`."""
        return cls(numbers[0], mi.Point2f(*numbers[1:3]), mi.Point2f(*numbers[3:5]))

    def numbers(self) -> list[mi.Float]:
        """All five of them."""
        return [self.choice, *self.place, *self.direction]


def emit_light(scene: mi.Scene, sampler: mi.Sampler) -> tuple[mi.Ray3f, mi.Color3f]:
    """Rays from the scene's emitters with their powers, W, (N,) each."""
    return emit_from(scene, EmitterSample.draw(sampler))


def emit_from(scene: mi.Scene, start: EmitterSample) -> tuple[mi.Ray3f, mi.Color3f]:
    """The rays that these random numbers stand for, with their powers, W, (N,) each."""
    ray, power, emitter = scene.sample_emitter_ray(
        mi.Float(0), start.choice, start.place, start.direction, mi.Bool(True)
    )
    ray.o = _spread_over_scene(scene, ray, emitter, start.place)
    return ray, power


def _spread_over_scene(
    scene: mi.Scene, ray: mi.Ray3f, emitter: mi.EmitterPtr, sample: mi.Point2f
) -> mi.Point3f:
    """Origins of the emitted rays; those of an environment map on a disc across their direction.

    Mitsuba 3.9 lays that disc across the direction before ``to_world``: from a turned map, too
    many or too few rays would meet the scene.
    """
    environment = scene.environment()
    if environment is None or environment.class_name() != "EnvironmentMapEmitter":
        return ray.o
    ball = scene.bbox().bounding_sphere()
    # As far out as the emitter has it, whose weight contains the disc's area.
    radius = dr.opaque(mi.Float, ball.radius * (1 + mi.math.RayEpsilon))
    disc = mi.warp.square_to_uniform_disk_concentric(sample)
    offset = mi.Frame3f(ray.d).to_world(mi.Vector3f(disc.x, disc.y, 0)) - ray.d
    center = mi.Point3f(ball.center)
    dr.make_opaque(center)
    origin = center + radius * offset
    return dr.select(emitter == mi.EmitterPtr(environment), origin, ray.o)

"""Participating media: which one rays are in, and flights through it.

A medium lies between surfaces that name it as their interior or exterior, with or without
refraction there. Its coefficients come from Mitsuba's plugins, for any place and each channel.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.loops import loops_traced_once
from gpf.scene.bounds import bounding_box
from gpf.scene.shapes import all_shapes

CROSSING = 4.0
"""Least number of places per crossing of the scene at which a flight asks what is there. In thin
fog, photons collide rarely; these places show where they pass. Far from the scene, where fog
without walls goes on, the distance from it counts instead of its size."""

# Most surfaces behind which a boundary between media is looked for.
_MOST_SURFACES = 32

LOOKUPS = 8
"""Places on a segment at which a medium that is not the same everywhere is asked for its mean
extinction."""

# A segment that leaves the scene, in a medium without a boundary, is so long.
_FAR = 1e8

# Farther than this many times the size of the scene, with its cameras and lamps, photons are too
# sparse to be found.
_SPARSE = 32

# Below this, a transmittance that is tracked survives at random.
_FAINT = 0.1

# Called at a place to which a flight came, in a recorded loop: visit(place, weight, active).
Visit = Callable[["Place", "mi.Color3f", "mi.Bool"], Any]


@dataclass
class Place:
    """A place in a medium, (N,).

    Attributes
    ----------
    p: position, world units, (N, 3).
    d: unit direction in which the light or the view ray goes there, (N, 3).
    medium: the medium.
    """

    p: mi.Point3f
    d: mi.Vector3f
    medium: mi.MediumPtr

    def interaction(self) -> mi.MediumInteraction3f:
        """The place as Mitsuba's plugins take it."""
        found = dr.zeros(mi.MediumInteraction3f, dr.width(self.p))
        found.p, found.wi = self.p, -self.d
        found.sh_frame = mi.Frame3f(found.wi)
        return found


@dataclass
class Flight:
    """Where a flight ended, (N,).

    Attributes
    ----------
    place: the last place.
    weight: by which the flight's power is multiplied, (N, 3).
    ratio: the density of the flight so far for each channel, divided by the mean of the three,
        (N, 3).
    scatters: whether it ended with a collision in the medium, not at its end.
    """

    place: Place
    weight: mi.Color3f
    ratio: mi.Color3f
    scatters: mi.Bool


class Media:
    """The media of a scene.

    Attributes
    ----------
    every: all of them.
    there: whether there are any. If not, nothing of this may be recorded.
    homogeneous: whether each is the same everywhere.
    """

    def __init__(self, scene: mi.Scene) -> None:
        self.scene = scene
        shapes = all_shapes(scene)
        inner, outer = (
            [medium for shape in shapes if (medium := side(shape)) is not None]
            for side in (mi.Shape.interior_medium, mi.Shape.exterior_medium)
        )
        named = [owner.get_medium() for owner in (*scene.sensors(), *scene.emitters())]
        # What cameras and lamps are in, but no shape has inside, is around all shapes.
        endless = [medium for medium in named if medium is not None and medium not in inner]
        self.every = list(dict.fromkeys((*endless, *inner, *outer)))
        self.there = bool(self.every)
        if not self.there:
            return
        self.homogeneous = all(medium.is_homogeneous() for medium in self.every)
        self._everywhere = endless[0] if endless else None

    @cached_property
    def _box(self) -> tuple[np.ndarray, float]:
        """The middle and the diagonal of the box around shapes, cameras and lamps, world units."""
        owners = (*self.scene.sensors(), *self.scene.emitters())
        boxes = [[owner.bbox().min, owner.bbox().max] for owner in owners if owner.bbox().valid()]
        corners = np.array([bounding_box(self.scene), *boxes], float).reshape(-1, 3)
        lower, upper = corners.min(axis=0), corners.max(axis=0)
        return (lower + upper) / 2, float(np.linalg.norm(upper - lower))

    @loops_traced_once
    @dr.syntax
    def around(self, ray: mi.Ray3f, active: mi.Bool) -> mi.MediumPtr:
        """The medium at the origins of rays, (N,).

        It is the one on the near side of the first boundary between media, behind any other
        surfaces.
        """
        found = dr.zeros(mi.MediumPtr, dr.width(active))
        if self._everywhere is not None:
            found = dr.select(active, mi.MediumPtr(self._everywhere), found)
        onwards = mi.Ray3f(ray)
        onwards.maxt = dr.largest(mi.Float)
        surfaces, looking = mi.UInt32(0), mi.Bool(active)
        while dr.hint(looking, exclude=[]):
            si = self.scene.ray_intersect(onwards, mi.RayFlags.Minimal, False, looking)
            looking &= si.is_valid()
            boundary = looking & si.is_medium_transition()
            found = dr.select(boundary, si.target_medium(-onwards.d), found)
            onwards = si.spawn_ray(onwards.d)
            surfaces += 1
            looking &= ~boundary & (surfaces < _MOST_SURFACES)
        return found

    def span(
        self, medium: mi.MediumPtr, ray: mi.Ray3f, distance: mi.Float, active: mi.Bool
    ) -> tuple[mi.Float, mi.Float, mi.Bool]:
        """Where a medium begins and ends on segments, (N,), and whether it does at all."""
        active = active & (medium != dr.zeros(mi.MediumPtr))
        inside, near, far = medium.intersect_aabb(ray)
        near, far = dr.maximum(near, 0), dr.minimum(far, dr.minimum(distance, _FAR))
        return near, far, active & inside & (near < far)

    def transmittance(
        self,
        medium: mi.MediumPtr,
        ray: mi.Ray3f,
        distance: mi.Float,
        random: mi.Float,
        active: mi.Bool,
    ) -> mi.Color3f:
        """The share of light that passes a distance without a collision, (N, 3); in media that are
        not the same everywhere, an estimate that depends on the ray and a random number."""
        near, far, active = self.span(medium, ray, distance, active)
        if not self.homogeneous:
            return self._track(medium, ray, near, far, random, active)
        extinction = medium.get_majorant(Place(ray.o, ray.d, medium).interaction(), active)
        return dr.select(active, dr.exp(-extinction * (far - near)), 1)

    @loops_traced_once
    @dr.syntax
    def _track(  # type: ignore[no-untyped-def]
        self, medium, ray, near, far, random, active
    ) -> mi.Color3f:
        """Ratio tracking from ``near`` to ``far`` (Novák et al. 2014); another random number, or
        another ray, gives an independent estimate."""
        majorant = medium.get_majorant(Place(ray.o, ray.d, medium).interaction(), active)
        rate, seed, number = dr.max(majorant), _hash_of(random, *ray.o, *ray.d), mi.UInt32(0)
        share, t, flying = mi.Color3f(1), mi.Float(near), active & (rate > 0)
        while dr.hint(flying, exclude=[far, rate, seed]):
            t -= dr.log(1 - mi.sample_tea_float32(seed, number)) / rate
            number += 1
            flying &= t < far
            place = Place(ray(t), ray.d, medium).interaction()
            extinction = medium.get_scattering_coefficients(place, flying)[2]
            share *= dr.select(flying, 1 - extinction / rate, 1)
            chance = dr.minimum(dr.max(share) / _FAINT, 1)
            lives = mi.sample_tea_float32(seed, number) < chance
            share *= dr.select(flying, dr.select(lives, 1 / chance, 0), 1)
            number += 1
            flying &= lives
        return share

    @loops_traced_once
    @dr.syntax
    def mean_extinction(  # type: ignore[no-untyped-def]
        self, medium, ray, near, far, sampler, active
    ) -> mi.Color3f:
        """The mean extinction from ``near`` to ``far``, 1/m, (N, 3); estimated from
        :data:`LOOKUPS` places in media that are not the same everywhere."""
        if dr.hint(self.homogeneous, mode="scalar"):
            return medium.get_majorant(Place(ray.o, ray.d, medium).interaction(), active)
        total, number = mi.Color3f(0), mi.UInt32(0)
        while number < LOOKUPS:
            t = dr.lerp(near, far, (mi.Float(number) + sampler.next_1d(active)) / LOOKUPS)
            place = Place(ray(t), ray.d, medium).interaction()
            total += medium.get_scattering_coefficients(place, active)[2] / LOOKUPS
            number += 1
        return total

    @dr.syntax
    def fly(  # type: ignore[no-untyped-def]
        self, medium, ray, distance, channel, ratio, sampler, active, visit: Visit
    ) -> Flight:
        """Fly through a medium until a collision, or as far as ``distance``, by null collisions.

        The weights combine the three channels' densities by the balance heuristic: where their
        extinctions differ, that of a single channel would make some weights unbounded.

        Parameters
        ----------
        medium: the medium at the origins, (N,); none: the flight has no effect.
        channel: the channel whose extinction determines the distances, 0 to 2, at random once per
            path, (N,).
        ratio: as in :class:`Flight`; 1 at first.
        visit: called as ``visit(place, w, active)`` wherever a flight asks what is there. The
            expected sum of w f(place) over these places is the integral of f along the ray,
            weighted by the transmittance, (N, 3).
        """
        place = Place(mi.Point3f(ray.o), mi.Vector3f(ray.d), mi.MediumPtr(medium))
        weight, ratio = mi.Color3f(1), mi.Color3f(ratio)
        scatters = mi.Bool(False)
        t, far, flying = self.span(medium, ray, distance, active)
        majorant = medium.get_majorant(place.interaction(), flying)
        middle, size = mi.Point3f(self._box[0].tolist()), dr.opaque(mi.Float, self._box[1])
        dr.make_opaque(middle)
        while dr.hint(flying, exclude=[far, majorant, middle, size]):
            rate = dr.maximum(majorant, CROSSING / dr.maximum(size, dr.norm(ray(t) - middle)))
            step = -dr.log(1 - sampler.next_1d(flying)) / of_channel(rate, channel)
            stays = flying & (t + step < far)
            length = dr.minimum(step, far - t)
            t += length
            through = dr.exp(-rate * length)
            weight, ratio = _go_on(weight, ratio, through, through * dr.select(stays, rate, 1))
            place.p = dr.select(stays, ray(t), place.p)
            visit(place, weight, stays & (dr.norm(place.p - middle) < _SPARSE * size))
            scattering, _, extinction = medium.get_scattering_coefficients(
                place.interaction(), stays
            )
            chance = extinction / rate
            scatters = stays & (sampler.next_1d(stays) < of_channel(chance, channel))
            factor = dr.select(scatters, scattering, rate - extinction)
            chance = dr.select(scatters, chance, 1 - chance)
            weight, ratio = _go_on(
                weight, ratio, dr.select(stays, factor, 1), dr.select(stays, chance, 1)
            )
            flying &= stays & ~scatters
        return Flight(place, weight, ratio, scatters)


def medium_at(scene: mi.Scene, place: Sequence[float]) -> mi.Medium | None:
    """The medium at a place, world units, or None."""
    ray = mi.Ray3f(mi.Point3f(*place), dr.normalize(mi.Vector3f(0.3, 0.8, 0.5)))
    media = Media(scene)
    if not media.there:
        return None
    found = media.around(ray, mi.Bool(True))
    return next((m for m in media.every if dr.all(found == mi.MediumPtr(m))), None)


def _hash_of(*values: mi.Float) -> mi.UInt32:
    """A number that looks random, (N,)."""
    total = mi.UInt32(0)
    for value in values:
        total = mi.sample_tea_32(total, dr.reinterpret_array(mi.UInt32, mi.Float(value)))[0]
    return total


def of_channel(value: mi.Color3f, channel: mi.UInt32) -> mi.Float:
    """One channel of a colour, (N,)."""
    return dr.select(channel == 0, value.x, dr.select(channel == 1, value.y, value.z))


def _go_on(
    weight: mi.Color3f, ratio: mi.Color3f, value: mi.Color3f, density: mi.Color3f
) -> tuple[mi.Color3f, mi.Color3f]:
    """The weight and the ratio of a flight after a random event with a value, and a density for
    each channel."""
    both = ratio * density
    mean = dr.mean(both)
    return weight * value / mean, both / mean

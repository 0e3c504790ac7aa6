"""Participating media: which one rays are in, and flights through it.

A medium lies between surfaces that name it as their interior or exterior, with or without
refraction there. Its coefficients come from Mitsuba's plugins, for any place and each channel.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.loops import loops_traced_once
from gpf.core.structs import from_numpy
from gpf.scene.bounds import scene_bounds

CROSSING = 4.0
"""Least number of places per crossing of the scene at which a flight asks what is there. In thin
fog, photons collide rarely; these places show where they pass."""

# Most surfaces behind which a boundary between media is looked for.
_MOST_SURFACES = 32

# A segment that leaves the scene, in a medium without a boundary, is so long.
_FAR = 1e8

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
    there: whether there are any. If not, nothing of this may be recorded.
    lamps, places: number of lamps that have a place, and their places, (L, 3).
    """

    def __init__(self, scene: mi.Scene) -> None:
        self.scene = scene
        bounded = [m for s in scene.shapes() for m in (s.interior_medium(), s.exterior_medium())]
        # A medium without a boundary is named only by the cameras and lamps in it.
        named = [owner.get_medium() for owner in (*scene.sensors(), *scene.emitters())]
        endless = [m for m in named if m is not None and m not in bounded]
        self.there = bool(endless) or any(medium is not None for medium in bounded)
        if not self.there:
            return
        self._everywhere = mi.MediumPtr(endless[0]) if endless else dr.zeros(mi.MediumPtr)
        self.lamps, self.places = _lamp_places(scene)
        lower, upper = scene_bounds(scene)
        self._least = dr.opaque(mi.Float, CROSSING / float(dr.norm(upper - lower)))

    @loops_traced_once
    @dr.syntax
    def around(self, ray: mi.Ray3f, active: mi.Bool) -> mi.MediumPtr:
        """The medium at the origins of rays, (N,).

        It is the one on the near side of the first boundary between media, behind any other
        surfaces.
        """
        found = dr.select(active, self._everywhere, dr.zeros(mi.MediumPtr))
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

    def transmittance(
        self, medium: mi.MediumPtr, ray: mi.Ray3f, distance: mi.Float, active: mi.Bool
    ) -> mi.Color3f:
        """The share of light that passes a distance without a collision, (N, 3)."""
        active = active & (medium != dr.zeros(mi.MediumPtr))
        place = Place(ray.o, ray.d, medium)
        extinction = medium.get_majorant(place.interaction(), active)
        return dr.select(active, dr.exp(-extinction * dr.minimum(distance, _FAR)), 1)

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
        flying = active & (medium != dr.zeros(mi.MediumPtr))
        inside, near, far = medium.intersect_aabb(ray)
        t, far = dr.maximum(near, 0), dr.minimum(far, distance)
        flying &= inside & (t < far)
        rate = dr.maximum(medium.get_majorant(place.interaction(), flying), self._least)
        own = of_channel(rate, channel)
        while dr.hint(flying, exclude=[far, rate, own]):
            step = -dr.log(1 - sampler.next_1d(flying)) / own
            stays = flying & (t + step < far)
            length = dr.minimum(step, far - t)
            t += length
            through = dr.exp(-rate * length)
            weight, ratio = _go_on(weight, ratio, through, through * dr.select(stays, rate, 1))
            place.p = dr.select(stays, ray(t), place.p)
            visit(place, weight, stays)
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


def _lamp_places(scene: mi.Scene) -> tuple[int, mi.Point3f]:
    found = []
    for emitter in scene.emitters():
        if emitter.is_environment() or mi.has_flag(emitter.flags(), mi.EmitterFlags.Infinite):
            continue
        box = emitter.bbox() if emitter.get_shape() is None else emitter.get_shape().bbox()
        if box.valid():
            found.append(np.array(box.center()).ravel())
    return len(found), from_numpy(mi.Point3f, np.array(found).reshape(-1, 3))


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

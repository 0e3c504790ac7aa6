"""What media between the camera and the visible points do to camera rays: they dim what is behind,
and scatter light towards the camera.

Of all places along a ray, one is chosen at random, in proportion to what it may contribute; light
is looked up there.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from gpf.core.random import next_2d
from gpf.core.structs import Haze
from gpf.scene.lamps import Lamps
from gpf.scene.media import Media, Place, of_channel

# Rays that leave the scene in a medium without a boundary go so far.
_FAR = 1e8


@dataclass
class View:
    """A view ray in media: the medium that it is in, (N,), the place chosen so far, and the sum of
    the chances of all places so far, (N,)."""

    medium: mi.MediumPtr
    haze: Haze
    chances: mi.Float


def start_view(media: Media, ray: mi.Ray3f, active: mi.Bool) -> View:
    """The state at the origin of rays."""
    return View(media.around(ray, active), nothing_seen(), mi.Float(0))


def nothing_seen() -> Haze:
    """No place in a medium."""
    return dr.zeros(Haze)


@dr.syntax
def look_through(  # type: ignore[no-untyped-def]
    view: View, media: Media, ray, distance, throughput, depth, counts, sampler, active
) -> tuple[View, mi.Color3f]:
    """Look through the medium to the end of a segment; returns the new state and how much of the
    light from there arrives, (N, 3).

    Parameters
    ----------
    distance: length of the segment, (N,).
    counts: whether places on the segment may be chosen, (N,).
    """
    through = mi.Color3f(1)
    distance = dr.minimum(distance, _FAR)
    active = active & (view.medium != dr.zeros(mi.MediumPtr))
    place = Place(ray.o, ray.d, view.medium)
    at, weight = mi.Point3f(ray.o), mi.Color3f(0)
    if view.medium.is_homogeneous() & active:
        extinction = view.medium.get_majorant(place.interaction(), active)
        scattering = view.medium.get_scattering_coefficients(place.interaction(), active)[0]
        t, share = _choose_distance(media, ray, extinction, distance, sampler, active)
        through = dr.exp(-extinction * distance)
        at, weight = ray(t), share * scattering
    chance = dr.select(active & counts, dr.max(dr.abs(throughput) * (1 - through)), 0)
    chance = dr.select(dr.any(weight > 0), chance, 0)
    view.chances += chance
    chosen = sampler.next_1d(active) * view.chances < chance
    haze = Haze(
        p=at,
        d=mi.Vector3f(ray.d),
        medium=view.medium,
        weight=throughput * weight / chance,
        depth=depth,
        valid=chosen,
    )
    view.haze = dr.select(chosen, haze, view.haze)
    return view, through


def _choose_distance(
    media: Media,
    ray: mi.Ray3f,
    extinction: mi.Color3f,
    distance: mi.Float,
    sampler: mi.Sampler,
    active: mi.Bool,
) -> tuple[mi.Float, mi.Color3f]:
    """A distance at random, and the transmittance divided by its density, m, (N, 3).

    Half of the distances are distributed in proportion to the transmittance of a random channel.
    Near a lamp, the light grows with the inverse square of the distance from it; the other half is
    distributed like this along the ray, about one of the lamps (Kulla and Fajardo 2012).
    """
    channel = mi.UInt32(3 * sampler.next_1d(active))
    own = of_channel(extinction, channel)
    u = sampler.next_1d(active)
    lost = 1 - dr.exp(-own * distance)
    t = dr.select(own * distance < 1e-3, u * distance, -dr.log(1 - u * lost) / own)
    near = mi.Float(0)
    if media.lamps:
        number = dr.minimum(mi.UInt32(sampler.next_1d(active) * media.lamps), media.lamps - 1)
        towards = dr.gather(mi.Point3f, media.places, number, active) - ray.o
        middle = dr.dot(towards, ray.d)
        apart = dr.maximum(dr.norm(towards - middle * ray.d), 1e-6 * dr.abs(middle))
        first, last = dr.atan(-middle / apart), dr.atan((distance - middle) / apart)
        about = middle + apart * dr.tan(dr.lerp(first, last, u))
        t = dr.select(sampler.next_1d(active) < 0.5, about, t)
    t = dr.clip(t, 0, distance)
    through = dr.exp(-extinction * t)
    exact = extinction * through / (1 - dr.exp(-extinction * distance))
    density = dr.mean(dr.select(extinction * distance < 1e-3, 1 / distance, exact))
    if media.lamps:
        near = apart / ((last - first) * (dr.square(apart) + dr.square(t - middle)))
        density = 0.5 * (density + near)
    return t, through / density


def lit_by(lamps: Lamps | None, haze: Haze, sampler: mi.Sampler) -> mi.Color3f:
    """The direct light of lamps that is scattered towards the camera, W/(m² sr), (N, 3)."""
    context, total = mi.PhaseFunctionContext(sampler), mi.Color3f(0)
    place = Place(haze.p, haze.d, haze.medium).interaction()
    phase = haze.medium.phase_function()
    for group in lamps.groups() if lamps else ():
        light, weight = group.sample(place, next_2d(sampler, haze.valid), haze.valid)
        share, _ = phase.eval_pdf(context, place, light.d, haze.valid & (light.pdf > 0))
        total += dr.select(light.pdf > 0, share * weight, 0)
    return total

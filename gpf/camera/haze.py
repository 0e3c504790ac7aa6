"""What media between the camera and the visible points do to camera rays: they dim what is behind,
and scatter light towards the camera.

Of all places along a ray, one is chosen at random, in proportion to what it may contribute; light
is looked up there.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from gpf.core.structs import Haze
from gpf.scene.media import Media, Place


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
        t, share = _choose_distance(extinction, distance, sampler, active)
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
    extinction: mi.Color3f, distance: mi.Float, sampler: mi.Sampler, active: mi.Bool
) -> tuple[mi.Float, mi.Color3f]:
    """A distance at random, about in proportion to the transmittance, and the transmittance divided
    by its density, m, (N, 3)."""
    channel = mi.UInt32(3 * sampler.next_1d(active))
    own = dr.select(channel == 0, extinction.x, dr.select(channel == 1, extinction.y, extinction.z))
    u = sampler.next_1d(active)
    lost = 1 - dr.exp(-own * distance)
    t = dr.select(own * distance < 1e-3, u * distance, -dr.log(1 - u * lost) / own)
    t = dr.minimum(t, distance)
    thin = extinction * distance < 1e-3
    through = dr.exp(-extinction * t)
    exact = extinction * through / (1 - dr.exp(-extinction * distance))
    density = dr.mean(dr.select(thin, 1 / distance, exact))
    return t, through / density

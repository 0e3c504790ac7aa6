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


@dataclass
class View:
    """A view ray in media: the medium that it is in, (N,), the place chosen so far, and the sum of
    the chances of all places so far, (N,)."""

    medium: mi.MediumPtr
    haze: Haze
    chances: mi.Float


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
    near, far, inside = media.span(view.medium, ray, distance, active)
    extinction = media.mean_extinction(view.medium, ray, near, far, sampler, inside)
    t, density = _choose_distance(media.scene, ray, extinction, near, far, sampler, inside)
    onward = mi.Ray3f(ray)
    onward.o = ray(t)
    random = sampler.next_1d(inside)
    to_place = media.transmittance(view.medium, ray, t, random, inside)
    through = to_place * media.transmittance(view.medium, onward, distance - t, random, inside)
    place = Place(onward.o, ray.d, view.medium).interaction()
    scattering = view.medium.get_scattering_coefficients(place, inside & counts)[0]
    weight = throughput * to_place * scattering / density
    chance = dr.select(inside & counts, dr.max(dr.abs(weight)), 0)
    view.chances += chance
    chosen = sampler.next_1d(inside) * view.chances < chance
    haze = Haze(
        p=onward.o,
        d=mi.Vector3f(ray.d),
        medium=view.medium,
        weight=weight / chance,
        depth=depth,
        valid=chosen,
    )
    view.haze = dr.select(chosen, haze, view.haze)
    return view, through


def _choose_distance(
    scene: mi.Scene,
    ray: mi.Ray3f,
    extinction: mi.Color3f,
    near: mi.Float,
    far: mi.Float,
    sampler: mi.Sampler,
    active: mi.Bool,
) -> tuple[mi.Float, mi.Float]:
    """A distance at random between two others, and its density, 1/m, (N,) each.

    Half of the distances are distributed in proportion to the transmittance of a random channel, as
    if the extinction were the same everywhere. Near a lamp, the light grows with the inverse square
    of the distance from it; the other half is distributed like this along the ray, about a point
    on a lamp (Kulla and Fajardo 2012).
    """
    own = of_channel(extinction, mi.UInt32(3 * sampler.next_1d(active)))
    u, length = sampler.next_1d(active), far - near
    lost = 1 - dr.exp(-own * length)
    t = near + dr.select(own * length < 1e-3, u * length, -dr.log(1 - u * lost) / own)
    lamp, lit = _point_on_lamp(scene, ray, sampler, active)
    middle = dr.dot(lamp - ray.o, ray.d)
    apart = dr.maximum(dr.norm(lamp - ray(middle)), 1e-6 * dr.abs(middle) + 1e-20)
    first, last = dr.atan((near - middle) / apart), dr.atan((far - middle) / apart)
    about = middle + apart * dr.tan(dr.lerp(first, last, u))
    t = dr.clip(dr.select(lit & (sampler.next_1d(active) < 0.5), about, t), near, far)

    exact = extinction * dr.exp(-extinction * (t - near)) / (1 - dr.exp(-extinction * length))
    density = dr.mean(dr.select(extinction * length < 1e-3, 1 / length, exact))
    by_lamp = apart / ((last - first) * (dr.square(apart) + dr.square(t - middle)))
    return t, dr.select(lit, 0.5 * (density + by_lamp), density)


def _point_on_lamp(
    scene: mi.Scene, ray: mi.Ray3f, sampler: mi.Sampler, active: mi.Bool
) -> tuple[mi.Point3f, mi.Bool]:
    """A point on one of the lamps at random, (N, 3), and whether it has a place, (N,)."""
    count = len(scene.emitters())
    number = dr.minimum(mi.UInt32(sampler.next_1d(active) * count), count - 1)
    emitter = dr.gather(mi.EmitterPtr, scene.emitters_dr(), number, active)
    origin = dr.zeros(mi.Interaction3f)
    origin.p = ray.o
    point = mi.Point3f(emitter.sample_direction(origin, next_2d(sampler, active), active)[0].p)
    near = active & ~mi.has_flag(emitter.flags(), mi.EmitterFlags.Infinite)
    return dr.select(near, point, 0), near & dr.all(dr.isfinite(point))


def lit_by(lamps: Lamps | None, haze: Haze, sampler: mi.Sampler) -> mi.Color3f:
    """The direct light of lamps that is scattered towards the camera, W/(m² sr), (N, 3)."""
    context, total = mi.PhaseFunctionContext(sampler), mi.Color3f(0)
    place = Place(haze.p, haze.d, haze.medium).interaction()
    phase = haze.medium.phase_function()
    for group in lamps.groups() if lamps else ():
        light, weight = group.sample(place, next_2d(sampler, haze.valid), haze.valid, haze.medium)
        share, _ = phase.eval_pdf(context, place, light.d, haze.valid & (light.pdf > 0))
        total += dr.select(light.pdf > 0, share * weight, 0)
    return total

"""Camera rays in an order that keeps neighbours together."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

TILE = 4  # pixels; a tile of 4x4 is one packet of a 512-bit vector unit


def sample_tiled_rays(
    scene: mi.Scene, sensor: mi.Sensor, sampler: mi.Sampler
) -> tuple[Any, Any, mi.Vector2f]:
    """Rays, their weights, and film positions: what Mitsuba's ``sample_rays`` returns, by tiles.

    Mitsuba goes through a film row by row. The lanes of a packet then lie in a line of 16 pixels,
    and look into many different neighbourhoods; in a tile of 4×4 pixels they share most of them.
    Films that no whole number of tiles fills, and filters that reach beyond a pixel, are left to
    Mitsuba.
    """
    film = sensor.film()
    size, spp = film.crop_size(), sampler.sample_count()
    width, height = int(size[0]), int(size[1])
    if width % TILE or height % TILE or not keeps_to_pixels(sensor):
        base = mi.ad.integrators.common.ADIntegrator
        ray, weight, position = base.sample_rays(None, scene, sensor, sampler)
        return ray, weight, position

    index = dr.arange(mi.UInt32, width * height * spp) // dr.opaque(mi.UInt32, spp)
    tile, lane = index // (TILE * TILE), index % (TILE * TILE)
    per_row = dr.opaque(mi.UInt32, width // TILE)
    row = tile // per_row
    pixel = mi.Vector2u(
        (tile - row * per_row) * TILE + lane % TILE,
        row * TILE + lane // TILE,
    )
    ray, weight = sample_pixel_rays(sensor, sampler, pixel)
    # Without the place in the pixel, whose sum may be rounded up into the next one.
    return ray, weight, mi.Vector2f(pixel) + mi.ScalarVector2f(film.crop_offset())


def keeps_to_pixels(sensor: mi.Sensor) -> bool:
    """Whether a sample counts for the pixel that it lies in and no other, at one moment."""
    film = sensor.film()
    regular = film.rfilter().is_box_filter() and not film.sample_border()
    return bool(regular and sensor.shutter_open_time() == 0)


def sample_pixel_rays(
    sensor: mi.Sensor, sampler: mi.Sampler, pixel: mi.Vector2u
) -> tuple[Any, Any]:
    """Rays through random places in the given pixels, and their weights."""
    width, height = (int(n) for n in sensor.film().crop_size())
    position = mi.Point2f(mi.Vector2f(pixel) + sampler.next_2d())
    ray, weight = sensor.sample_ray_differential(
        time=sensor.shutter_open(),
        sample1=0,
        sample2=position * mi.ScalarVector2f(1 / width, 1 / height),
        sample3=sampler.next_2d() if sensor.needs_aperture_sample() else mi.Point2f(0),
    )
    return ray, weight

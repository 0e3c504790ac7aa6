"""Camera rays through points on the film."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

TILE = 4  # pixels; a tile of 4×4 is one packet of a 512-bit vector unit


def sample_tiled_rays(
    scene: mi.Scene, sensor: mi.Sensor, sampler: mi.Sampler
) -> tuple[Any, Any, mi.Vector2f]:
    """Rays, their weights (N, 3) and film positions (N, 2), like ``sample_rays`` of Mitsuba.

    Mitsuba orders pixels row by row: the 16 lanes of a packet are a line of pixels, whose rays end
    in many different neighbourhoods. The rays of a tile of 4×4 pixels share most of them. Mitsuba's
    order is kept if the film is not a whole number of tiles, or if :func:`keeps_to_pixels` is
    false.
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
    # Without the random offset: the sum could be rounded up into the next pixel.
    return ray, weight, mi.Vector2f(pixel) + mi.ScalarVector2f(film.crop_offset())


def keeps_to_pixels(sensor: mi.Sensor) -> bool:
    """Whether a sample counts only for its own pixel, and the shutter time is zero."""
    film = sensor.film()
    regular = film.rfilter().is_box_filter() and not film.sample_border()
    return bool(regular and sensor.shutter_open_time() == 0)


def sample_pixel_rays(
    sensor: mi.Sensor, sampler: mi.Sampler, pixel: mi.Vector2u
) -> tuple[Any, Any]:
    """Rays through random points in pixels of the crop window (N, 2), and their weights (N, 3)."""
    return sample_rays_at(sensor, sampler, mi.Point2f(mi.Vector2f(pixel) + sampler.next_2d()))


def sample_rays_at(
    sensor: mi.Sensor, sampler: mi.Sampler, place: mi.Point2f
) -> tuple[Any, mi.Color3f]:
    """Rays through points in the crop window, pixels (N, 2), and their weights (N, 3).

    The time and the point on the aperture are random.
    """
    time, duration = sensor.shutter_open(), sensor.shutter_open_time()
    with dr.resume_grad():  # of the camera, as in Mitsuba
        ray, weight = sensor.sample_ray_differential(
            time=time + (sampler.next_1d() * duration if duration > 0 else 0),
            sample1=0,
            sample2=place * (1 / mi.ScalarVector2f(sensor.film().crop_size())),
            sample3=sampler.next_2d() if sensor.needs_aperture_sample() else mi.Point2f(0),
        )
    return ray, weight

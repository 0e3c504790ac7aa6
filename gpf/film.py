"""The film: one camera ray per pixel and pass, and how what they find becomes an image."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from gpf.structs import VisiblePoints
from gpf.visible_points import find_visible_points


@dataclass
class FilmSamples:
    """One visible point per film sample, and where on the film it belongs.

    Attributes
    ----------
    points: visible points, (N,), pixel by pixel, x fastest.
    weight: importance of the ray, (N, 3).
    position: film position in pixels, (N, 2).
    """

    points: VisiblePoints
    weight: mi.Color3f
    position: mi.Point2f


def sample_grid(film: mi.Film) -> tuple[int, int]:
    """Width and height of the film in samples: its pixels, and a border if it asks for one."""
    border = film.rfilter().border_size() if film.sample_border() else 0
    width, height = (int(n) + 2 * border for n in film.crop_size())
    return width, height


def sample_film(
    scene: mi.Scene,
    sensor: mi.Sensor,
    sampler: mi.Sampler,
    max_depth: int = -1,
    rr_depth: int = 5,
    direct: bool = False,
    rows: range | None = None,
) -> FilmSamples:
    """Visible points of one camera ray in each pixel of some rows, or of all.

    The sampler has been seeded for as many lanes. With ``direct``, the points have had their
    direct light.
    """
    ray, weight, position = _sample_rays(sensor, sampler, rows)
    points = find_visible_points(scene, sampler, mi.Ray3f(ray), max_depth, rr_depth, direct=direct)
    return FilmSamples(points, weight, position)


def _sample_rays(sensor: mi.Sensor, sampler: mi.Sampler, rows: range | None) -> tuple[Any, ...]:
    """As Mitsuba's ``sample_rays`` does for a whole film: rays, weights and positions."""
    film = sensor.film()
    width, height = sample_grid(film)
    rows = rows or range(height)
    border = (width - int(film.crop_size()[0])) // 2
    index = dr.arange(mi.UInt32, width * len(rows))
    y = index // dr.opaque(mi.UInt32, width)
    pixel = mi.Vector2i(index - y * width, y + dr.opaque(mi.UInt32, rows.start))
    pixel += mi.ScalarVector2i(film.crop_offset()) - border
    position = mi.Point2f(pixel) + sampler.next_2d()
    scale = 1 / mi.ScalarVector2f(film.crop_size())
    ray, weight = sensor.sample_ray_differential(
        time=_sample_time(sensor, sampler),
        sample1=0,
        sample2=(position - mi.ScalarPoint2f(film.crop_offset())) * scale,
        sample3=sampler.next_2d() if sensor.needs_aperture_sample() else mi.Point2f(0),
    )
    return ray, weight, position


def _sample_time(sensor: mi.Sensor, sampler: mi.Sampler) -> Any:
    duration = sensor.shutter_open_time()
    return sensor.shutter_open() + (sampler.next_1d() * duration if duration > 0 else 0)


def reconstruct(
    film: mi.Film, position: mi.Point2f, radiance: mi.Color3f, alpha: mi.Float
) -> mi.TensorXf:
    """What the samples of a whole film add to its pixels, (H, W, C): RGB, alpha if asked, weight.

    Every pixel gathers the samples that its reconstruction filter reaches, always in the same
    order. Mitsuba lets samples add themselves to pixels, whenever their threads get to it: sums
    that are not the same twice.
    """
    filter_, (columns, lines) = film.rfilter(), sample_grid(film)
    width, height = (int(n) for n in film.crop_size())
    border = (columns - width) // 2
    index = dr.arange(mi.UInt32, width * height)
    y = index // dr.opaque(mi.UInt32, width)
    x = index - y * width
    channels = [*radiance, alpha] if mi.has_flag(film.flags(), mi.FilmFlags.Alpha) else [*radiance]
    sums = [mi.Float(0) for _ in channels] + [mi.Float(0)]
    centre = mi.Point2f(x, y) + 0.5 + mi.ScalarPoint2f(film.crop_offset())
    box = filter_.is_box_filter()
    # A sample lies anywhere in its own pixel.
    reach = 0 if box else math.floor(filter_.radius() + 0.5)
    for dy in range(-reach, reach + 1):
        for dx in range(-reach, reach + 1):
            column, line = mi.Int32(x) + (dx + border), mi.Int32(y) + (dy + border)
            exists = (column >= 0) & (column < columns) & (line >= 0) & (line < lines)
            sample = mi.UInt32(line * columns + column)
            weight = mi.Float(1)
            if not box:
                offset = dr.gather(mi.Point2f, position, sample, exists) - centre
                weight = filter_.eval(offset.x) * filter_.eval(offset.y)
            weight = dr.select(exists, weight, 0)
            for k, channel in enumerate(channels):
                sums[k] += weight * dr.gather(mi.Float, channel, sample, exists)
            sums[-1] += weight
    depth = len(sums)
    flat = dr.empty(mi.Float, width * height * depth)
    for k, value in enumerate(sums):
        dr.scatter(flat, value, index * depth + k)
    return mi.TensorXf(flat, shape=(height, width, depth))

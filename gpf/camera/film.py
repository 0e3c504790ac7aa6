"""The film: one camera ray per pixel and pass, and how what they find becomes an image."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from gpf.camera.visible_points import find_visible_points
from gpf.core.structs import VisiblePoints, concatenate
from gpf.scene.materials import is_only_glossy


@dataclass
class FilmSamples:
    """What one camera ray per pixel found, and where on the film it belongs.

    A ray that meets a glossy surface first is followed on several walks, for it may go anywhere.

    Attributes
    ----------
    points: visible points, (N + (K - 1) G,): of N rays, pixel by pixel, x fastest; then the further
        walks of the G rays that have K.
    weight: importance of the rays, (N, 3).
    position: film position of the rays, pixels, (N, 2).
    split: which rays have K walks, (G,).
    walks: K.
    """

    points: VisiblePoints
    weight: mi.Color3f
    position: mi.Point2f
    split: mi.UInt32
    walks: int

    def merge(self, radiance: mi.Color3f) -> mi.Color3f:
        """Mean radiance of each ray's walks, (N, 3), from that of all walks."""
        rays, extra = dr.width(self.position), dr.width(self.split)
        if extra == 0 or self.walks == 1:
            return radiance
        # A gather evaluates what it reads, one channel at a time: three searches instead of one.
        dr.eval(radiance)
        lanes = dr.arange(mi.UInt32, extra)
        total = dr.gather(mi.Color3f, radiance, self.split)
        for k in range(self.walks - 1):
            first = dr.opaque(mi.UInt32, rays + k * extra)
            total += dr.gather(mi.Color3f, radiance, lanes + first)
        merged = dr.gather(mi.Color3f, radiance, dr.arange(mi.UInt32, rays))
        dr.scatter(merged, total / self.walks, self.split)
        return merged


def sample_grid(film: mi.Film) -> tuple[int, int]:
    """Width and height of the film in samples: its pixels, and a border if it asks for one."""
    border = film.rfilter().border_size() if film.sample_border() else 0
    width, height = (int(n) + 2 * border for n in film.crop_size())
    return width, height


def sample_film(
    scene: mi.Scene,
    sensor: mi.Sensor,
    seed: int,
    max_depth: int = -1,
    rr_depth: int = 5,
    direct: bool = False,
    walks: int = 1,
    rows: range | None = None,
) -> FilmSamples:
    """Follow one camera ray in each pixel of some rows, or of all, to its visible point.

    With ``direct``, the points have had their direct light. ``walks`` is K for rays that meet a
    surface which is only glossy first; a scene without one should have 1.
    """
    width, height = sample_grid(sensor.film())
    rows = rows or range(height)
    sampler = mi.load_dict({"type": "independent", "sample_count": 1})
    sampler.seed(seed, width * len(rows))
    ray, weight, position = _sample_rays(sensor, sampler, rows)
    ray = mi.Ray3f(ray)
    options = {"max_depth": max_depth, "rr_depth": rr_depth, "direct": direct}
    points = find_visible_points(scene, sampler, ray, **options)
    samples = FilmSamples(points, weight, position, mi.UInt32(), 1)
    if walks > 1:
        dr.eval(samples, ray)
        samples.split = find_gloss(scene, ray)
        samples.walks = walks
        extra = (walks - 1) * dr.width(samples.split)
        if extra > 0:
            lane = dr.arange(mi.UInt32, extra) % dr.opaque(mi.UInt32, dr.width(samples.split))
            again = dr.gather(mi.Ray3f, ray, dr.gather(mi.UInt32, samples.split, lane))
            # Any seed but that of the first walks.
            sampler.seed((seed + 1) % 2**32, extra)
            further = find_visible_points(scene, sampler, again, **options)
            samples.points = concatenate([points, further])
    return samples


def find_gloss(scene: mi.Scene, ray: mi.Ray3f) -> mi.UInt32:
    """Which rays meet a surface first that is glossy and nothing else."""
    return dr.compress(meets_gloss(scene, ray, mi.Bool(True)))


def meets_gloss(scene: mi.Scene, ray: mi.Ray3f, active: mi.Bool) -> mi.Bool:
    """Whether a ray meets a surface first that is glossy and nothing else, (N,)."""
    si = scene.ray_intersect(ray, mi.RayFlags.Minimal, coherent=True, active=active)
    return active & si.is_valid() & is_only_glossy(si.bsdf())


def _sample_rays(sensor: mi.Sensor, sampler: mi.Sampler, rows: range) -> tuple[Any, ...]:
    """As Mitsuba's ``sample_rays`` does for a whole film: rays, weights and positions."""
    film = sensor.film()
    width, _ = sample_grid(film)
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

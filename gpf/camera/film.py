"""One camera ray per pixel and pass, and the reconstruction of an image from their radiance."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from gpf.camera.rays import sample_rays_at
from gpf.camera.visible_points import find_visible_points
from gpf.core.structs import Haze, VisiblePoints, concatenate
from gpf.scene.lamps import Lamps
from gpf.scene.materials import is_only_glossy


@dataclass
class FilmSamples:
    """The visible points of one camera ray per pixel, and the rays' positions on the film.

    A ray that hits a glossy surface first has K walks, because it may be reflected anywhere.

    Attributes
    ----------
    points: visible points, (N + (K - 1) G,): the first walk of all N rays in the order of pixels,
        x fastest; then the second walk of the G rays with K walks, and so on.
    weight: importance of the rays, (N, 3).
    position: positions of the rays on the film, pixels, (N, 2).
    split: indices of the rays with K walks, (G,).
    walks: K.
    """

    points: VisiblePoints
    haze: Haze
    weight: mi.Color3f
    position: mi.Point2f
    split: mi.UInt32
    walks: int

    def merge(self, radiance: mi.Color3f) -> mi.Color3f:
        """Mean radiance of the walks of each ray, (N, 3), from that of all ``points``."""
        rays, extra = dr.width(self.position), dr.width(self.split)
        if extra == 0 or self.walks == 1:
            return radiance
        # Without this, each gather evaluates its channel alone: three searches instead of one.
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
    """Width and height of the grid of samples, pixels: the crop window and any border."""
    border = film.rfilter().border_size() if film.sample_border() else 0
    width, height = (int(n) + 2 * border for n in film.crop_size())
    return width, height


def sample_film(
    scene: mi.Scene,
    sensor: mi.Sensor,
    seed: int,
    max_depth: int = -1,
    rr_depth: int = 5,
    lamps: Lamps | None = None,
    walks: int = 1,
    rows: range | None = None,
) -> FilmSamples:
    """Follow one camera ray per pixel to its visible point.

    Parameters
    ----------
    max_depth, rr_depth, lamps: as for :func:`find_visible_points`.
    walks: number of walks K of rays whose first surface is glossy without a diffuse component;
        give 1 if the scene has no such surface.
    rows: the rows of the sample grid; all by default.
    """
    width, height = sample_grid(sensor.film())
    rows = rows or range(height)
    sampler = mi.load_dict({"type": "independent", "sample_count": 1})
    sampler.seed(seed, width * len(rows))
    offset = mi.ScalarPoint2f(sensor.film().crop_offset())
    position = mi.Point2f(_pixels(sensor.film(), rows)) + sampler.next_2d()
    ray, weight = sample_rays_at(sensor, sampler, position - offset)
    ray = mi.Ray3f(ray)
    options: dict[str, Any] = {"max_depth": max_depth, "rr_depth": rr_depth, "lamps": lamps}
    points, haze = find_visible_points(scene, sampler, ray, **options)
    samples = FilmSamples(points, haze, weight, position, mi.UInt32(), 1)
    if walks > 1:
        dr.eval(samples, ray)
        samples.split = dr.compress(meets_gloss(scene, ray, mi.Bool(True)))
        samples.walks = walks
        extra = (walks - 1) * dr.width(samples.split)
        if extra > 0:
            lane = dr.arange(mi.UInt32, extra) % dr.opaque(mi.UInt32, dr.width(samples.split))
            again = dr.gather(mi.Ray3f, ray, dr.gather(mi.UInt32, samples.split, lane))
            # Different from the seed of the first walks.
            sampler.seed((seed + 1) % 2**32, extra)
            further, places = find_visible_points(scene, sampler, again, **options)
            samples.points = concatenate([points, further])
            samples.haze = concatenate([haze, places])
    return samples


def meets_gloss(scene: mi.Scene, ray: mi.Ray3f, active: mi.Bool) -> mi.Bool:
    """Whether the first surface of a ray is glossy without a diffuse component, (N,)."""
    si = scene.ray_intersect(ray, mi.RayFlags.Minimal, coherent=True, active=active)
    return active & si.is_valid() & is_only_glossy(si.bsdf())


def _pixels(film: mi.Film, rows: range) -> mi.Vector2i:
    """The pixels of some rows of the sample grid, in film coordinates, (N, 2)."""
    width, _ = sample_grid(film)
    border = (width - int(film.crop_size()[0])) // 2
    index = dr.arange(mi.UInt32, width * len(rows))
    y = index // dr.opaque(mi.UInt32, width)
    pixel = mi.Vector2i(index - y * width, y + dr.opaque(mi.UInt32, rows.start))
    pixel += mi.ScalarVector2i(film.crop_offset()) - border
    return pixel


def reconstruct(
    film: mi.Film, position: mi.Point2f, radiance: mi.Color3f, alpha: mi.Float
) -> mi.TensorXf:
    """The weighted sums of a film's samples at its pixels, (H, W, C).

    The channels are RGB, alpha if the film has it, and the sum of weights. Each pixel gathers the
    samples within the radius of the reconstruction filter in a fixed order. Mitsuba adds samples to
    pixels in the order of threads, so that its sums differ from run to run.

    Parameters
    ----------
    position: sample positions for the whole sample grid, pixels, (N, 2).
    radiance: (N, 3).
    alpha: (N,).
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
    # A sample may lie anywhere in its pixel, up to half a pixel from the centre.
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

"""Guides for a denoiser: images of the surfaces' albedo and normals."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.random import Stream, pass_seed
from gpf.rendering.batches import split_samples

# Rays of a guide in flight at once.
_LARGEST_WAVEFRONT = 1 << 24

# A ray follows at most this many specular events and ends at the next, whose colour is its albedo.
_MOST_BOUNCES = 16


def render_guides(
    scene: mi.Scene, sensor: mi.Sensor, spp: int, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """Albedo in [0, 1] and shading normal in world space, (H, W, 3) float32 each.

    Both are means over the pixel with a box filter, as in the image. They belong to the first
    surface where the sampled event is not specular, as the manual of Open Image Denoise recommends:
    mirrors and glass have the guides of what is seen in them. Both are zero where a ray meets
    nothing. Emitted light is added to the albedo, so the guide shows the outlines of lamps and sky.
    """
    width, height = (int(n) for n in sensor.film().crop_size())
    albedo, normal = np.zeros((2, height * width, 3))
    for part, share in enumerate(split_samples(spp, width * height, _LARGEST_WAVEFRONT)):
        found = _sample_guides(
            scene, sensor, (width, height), share, pass_seed(seed, part, Stream.DENOISING_GUIDES)
        )
        for total, value in zip((albedo, normal), found, strict=True):
            total += _pixel_means(value, share) * (share / spp)
    images = [np.clip(albedo, 0, 1), normal]
    shape = (height, width, 3)
    flat = [np.ascontiguousarray(image.reshape(shape), dtype=np.float32) for image in images]
    return flat[0], flat[1]


def are_noisy(scene: mi.Scene) -> bool:
    """Whether guides may be noisy: some BSDF has a specular event, and chance selects the event."""
    objects = mi.traverse(scene).hierarchy
    return any(
        mi.has_flag(o.flags(), mi.BSDFFlags.Delta) for o in objects if isinstance(o, mi.BSDF)
    )


def _sample_guides(
    scene: mi.Scene, sensor: mi.Sensor, size: tuple[int, int], spp: int, seed: int
) -> tuple[Any, Any]:
    width, height = size
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, width * height * spp)
    pixel = dr.arange(mi.UInt32, width * height * spp) // dr.opaque(mi.UInt32, spp)
    y = pixel // dr.opaque(mi.UInt32, width)
    place = mi.Point2f(pixel - y * width, y) + sampler.next_2d()
    place /= mi.Point2f(dr.opaque(mi.Float, width), dr.opaque(mi.Float, height))
    ray, _ = sensor.sample_ray(mi.Float(0), mi.Float(0), place, mi.Point2f(0))
    found = _follow(scene, sampler, ray)
    dr.eval(found)
    return found


@dr.syntax
def _follow(scene: mi.Scene, sampler: mi.Sampler, ray: mi.Ray3f) -> tuple[mi.Color3f, mi.Vector3f]:
    """Albedo, including lamps and the throughput of the path to it, and normal, (N, 3) each."""
    context = mi.BSDFContext()
    last = dr.opaque(mi.UInt32, _MOST_BOUNCES)
    ray = mi.Ray3f(ray)
    albedo = mi.Color3f(0)
    normal = mi.Vector3f(0)
    throughput = mi.Color3f(1)
    depth = mi.UInt32(0)
    active = mi.Bool(True)

    while active:
        si = scene.ray_intersect(ray, active=active)
        light = dr.minimum(si.emitter(scene).eval(si, active), 1)
        albedo += dr.select(active, throughput * light, 0)
        active &= si.is_valid()

        # The mean of the weights is the albedo.
        sample, weight = si.bsdf(ray).sample(
            context, si, sampler.next_1d(active), sampler.next_2d(active), active
        )
        throughput *= weight
        goes_on = mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta) & (depth < last)
        if active & ~goes_on:
            albedo += throughput
            normal = mi.Vector3f(si.sh_frame.n)
        active &= goes_on & (dr.max(throughput) > 0)
        ray = si.spawn_ray(si.to_world(sample.wo))
        depth += 1

    return albedo, normal


def _pixel_means(samples: Any, spp: int) -> np.ndarray:
    """Means over the samples of each pixel, (N, 3), from (3, N spp)."""
    return np.asarray(samples.numpy(), dtype=np.float64).reshape(3, -1, spp).mean(-1).T

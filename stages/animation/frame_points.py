"""The points that the pixels of a view see, if they can be found again in another view."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.scene.materials import has_diffuse
from gpf.scene.sensors import make_sensor
from gpf.scene.views import View

# Largest number of water and glass surfaces that a ray passes through.
MOST_SURFACES = 16


@dataclass(frozen=True)
class SeenPoints:
    """Diffuse points at the centres of pixels.

    Attributes
    ----------
    points: positions, world units, (H, W, 3).
    directly: pixels that see a point through air alone, (H, W), bool.
    refracted: pixels that see a point through smooth water or glass, (H, W), bool.
    """

    points: np.ndarray
    directly: np.ndarray
    refracted: np.ndarray


@dr.syntax
def see_points(scene: mi.Scene, view: View, size: tuple[int, int]) -> SeenPoints:
    """Follow a ray through the centre of each pixel, straight or refracted, to a diffuse surface.

    A ray finds no point if it meets a mirror, a glossy surface, a lamp or nothing, or is totally
    reflected: the colour of such pixels depends on the viewpoint.
    """
    width, height = size
    sensor = make_sensor(view, width, height)
    index = dr.arange(mi.UInt32, width * height)
    row = index // dr.opaque(mi.UInt32, width)
    column = index - row * dr.opaque(mi.UInt32, width)
    place = mi.Point2f((column + 0.5) / width, (row + 0.5) / height)
    ray, _ = sensor.sample_ray(0, 0.5, place, mi.Point2f(0.5))

    ray = mi.Ray3f(ray)
    active = mi.Bool(True)
    surfaces = mi.UInt32(0)
    p = mi.Point3f(0)
    found = mi.Bool(False)
    while active:
        si = scene.ray_intersect(ray, active=active)
        active &= si.is_valid()
        bsdf = si.bsdf(ray)
        flags = bsdf.flags()
        ends = active & has_diffuse(bsdf, si)
        # The colour of surfaces with further lobes depends on the viewpoint.
        others = mi.has_flag(flags, mi.BSDFFlags.Glossy) | mi.has_flag(flags, mi.BSDFFlags.Delta)
        if ends & ~others & ~(si.shape.is_emitter()):
            p = mi.Point3f(si.p)
            found = mi.Bool(True)
        active &= ~ends & mi.has_flag(flags, mi.BSDFFlags.DeltaTransmission)
        # For a smooth dielectric, this is the refracted direction, if there is one.
        sample, _ = bsdf.sample(mi.BSDFContext(), si, 1 - 1e-6, mi.Point2f(0.5), active)
        active &= mi.has_flag(sample.sampled_type, mi.BSDFFlags.DeltaTransmission)
        ray = si.spawn_ray(si.to_world(sample.wo))
        surfaces += dr.select(active, 1, 0)
        active &= surfaces < MOST_SURFACES

    seen = found.numpy().reshape(height, width)
    through = (surfaces.numpy() > 0).reshape(height, width)
    points = np.ascontiguousarray(p.numpy().T).reshape(height, width, 3)
    return SeenPoints(points, seen & ~through, seen & through)

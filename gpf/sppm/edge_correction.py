"""How much of a kernel's disc lies on a surface: at edges, photons can land on a part of it only.

The kernel density estimate divides by the area of a disc, π r². Where the surface ends within the
disc (a wall in a corner, the rim of a table), what is there gathers less, and images get dark
lines along edges that only fade as the radius shrinks.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from gpf.core.surface_tags import SAME_SURFACE_COSINE, SAME_SURFACE_HEIGHT

# A point on something much smaller than the disc would look for it forever.
_MOST_TRIALS = 8


@dr.syntax
def area_correction(
    scene: mi.Scene,
    p: mi.Point3f,
    n: mi.Normal3f,
    valid: mi.Bool,
    radius: float,
    seed: int,
    smooth: bool = False,
) -> mi.Float:
    """An estimate of π r² / A(x), (N,), A being the area on which photons count at x, by the
    kernel's measure.

    Short rays, perpendicular to the disc, go through random points of it until one meets the
    surface. If that happens with probability c, the number of rays has the expected value 1/c; it
    ends at 8, which is short of that by 0.4 % where c is a half, and by 10 % where it is a quarter.
    The
    ball around x cuts as much off a curved surface or one with a crease as off a plane (a sphere:
    exactly so); the disc is thus taken to be bent as the surface is. What lies inside of a box that
    stands on the surface, or behind a wall that goes through it, counts like the rest.

    Parameters
    ----------
    p, n: positions and oriented normals, (N, 3).
    valid: points that take part, (N,); 1 elsewhere.
    radius: kernel radius, world units.
    seed: the numbers that a point draws depend on it and on the point's position alone.
    smooth: whether the kernel is (:class:`gpf.sppm.density.PhotonDensity`).
    """
    r, key = dr.opaque(mi.Float, radius), dr.opaque(mi.UInt32, seed)
    frame = mi.Frame3f(n)
    bits = [dr.reinterpret_array(mi.UInt32, p[i]) for i in range(3)]
    first, second = mi.sample_tea_32(bits[0] ^ key, bits[1])
    first, second = mi.sample_tea_32(first ^ bits[2], second)

    trials = mi.UInt32(0)
    ray, left = mi.Ray3f(p, -n, 0, 0, mi.Color0f()), mi.Float(0)
    active = mi.Bool(valid)
    while active:
        if left <= 0:
            trials += 1
            first, second = mi.sample_tea_32(first, second)
            disc = r * mi.warp.square_to_uniform_disk(
                mi.Point2f(mi.Float(first >> 8), mi.Float(second >> 8)) * 2.0**-24
            )
            if smooth:  # from a uniform density to one of (1 - s), s being the squared distance
                disc *= dr.rsqrt(1 + dr.sqrt(dr.maximum(1 - dr.squared_norm(disc) / (r * r), 0)))
            ray.o = p + frame.to_world(mi.Vector3f(disc.x, disc.y, r))
            left = 2 * r
        ray.maxt = left
        si = scene.ray_intersect(ray, mi.RayFlags.Minimal, coherent=False, active=active)
        cosine = dr.abs(dr.dot(si.n, n))
        # As high as the kernel allows on the surface, which rises more steeply than on the disc.
        flat = dr.abs(dr.dot(n, si.p - p)) * cosine <= SAME_SURFACE_HEIGHT * r
        found = si.is_valid() & flat & (cosine > SAME_SURFACE_COSINE)
        found &= mi.has_flag(si.bsdf().flags(), mi.BSDFFlags.Diffuse)
        # Glass that lies on the surface is no end of it: go on behind.
        step = si.t + 1e-3 * r
        ray.o = ray(step)
        left = dr.select(si.is_valid(), left - step, 0)
        active &= ~found & ((left > 0) | (trials < _MOST_TRIALS))
    return dr.select(valid, mi.Float(trials), 1)

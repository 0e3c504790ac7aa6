"""Edge correction: what part of the kernel's disc lies on the surface.

The kernel density estimate divides by the area of a disc, π r². Where the surface ends within the
disc (a wall in a corner, the rim of a table), photons land on a part of the disc only. The estimate
is then too low, and images get dark lines along edges, which fade only as the radius shrinks.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from gpf.core.surface_tags import SAME_SURFACE_COSINE, SAME_SURFACE_HEIGHT

# Without a limit, a point on an object much smaller than the disc would need very many trials.
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
    """An estimate of π r² / A(x), (N,); A(x) is the area on which photons count at x, weighted by
    the kernel.

    Short rays, perpendicular to the disc, go through random points of the disc until one of them
    meets the surface. If a ray does so with probability c, the expected number of rays is 1/c. The
    number is limited to 8, which makes the mean too small by 0.4 % for c = 1/2 and by 10 % for
    c = 1/4.

    The ball around x cuts the same area from a curved surface, or from one with a crease, as from
    a plane (for a sphere: exactly). The disc is therefore treated as bent like the surface. Surface
    inside a box that stands on it, or behind a wall that crosses it, counts like the rest.

    Parameters
    ----------
    p, n: positions and oriented normals, (N, 3).
    valid: points that take part, (N,); the result is 1 at all others.
    radius: kernel radius, world units.
    seed: a point's random numbers depend on the seed and the point's position alone.
    smooth: whether the kernel is the smooth one of :class:`gpf.sppm.density.PhotonDensity`.
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
            if smooth:  # from a uniform density to (1 - s); s is the squared distance
                disc *= dr.rsqrt(1 + dr.sqrt(dr.maximum(1 - dr.squared_norm(disc) / (r * r), 0)))
            ray.o = p + frame.to_world(mi.Vector3f(disc.x, disc.y, r))
            left = 2 * r
        ray.maxt = left
        si = scene.ray_intersect(ray, mi.RayFlags.Minimal, coherent=False, active=active)
        cosine = dr.abs(dr.dot(si.n, n))
        # The kernel's limit on height; the cosine accounts for the slope of the surface.
        flat = dr.abs(dr.dot(n, si.p - p)) * cosine <= SAME_SURFACE_HEIGHT * r
        found = si.is_valid() & flat & (cosine > SAME_SURFACE_COSINE)
        found &= mi.has_flag(si.bsdf().flags(), mi.BSDFFlags.Diffuse)
        # Glass may lie on the surface: continue behind it.
        step = si.t + 1e-3 * r
        ray.o = ray(step)
        left = dr.select(si.is_valid(), left - step, 0)
        active &= ~found & ((left > 0) | (trials < _MOST_TRIALS))
    return dr.select(valid, mi.Float(trials), 1)

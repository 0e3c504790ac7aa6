"""Edge correction: the part of the kernel's disc that lies on the surface.

The kernel density estimate divides by the area of a disc, π r². Where the surface ends within the
disc (a wall in a corner, the rim of a table), photons land on only part of the disc. The estimate
is then too low, and images get dark lines along edges, which fade only as the radius shrinks.

Each pass of SPPM corrects its estimate with a few random rays (:func:`area_correction`), so that
the mean over many passes is right. When the photons of all passes are gathered at once, the area
itself is needed (:func:`covered_share`), at the points where it matters (:func:`near_edges`).

In a medium, the kernel's ball is cut off by surfaces in the same way (:func:`ball_correction`).
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from gpf.core.loops import loops_traced_once
from gpf.core.surface_tags import SAME_SURFACE_COSINE, SAME_SURFACE_HEIGHT
from gpf.photons.photon_grid import rounded_normal

# Without a limit, a point on an object much smaller than the disc would need very many trials.
_MOST_TRIALS = 8

# In a corner of a medium, an eighth of the ball is left.
_MOST_TRIALS_IN_BALL = 24

# Angle between successive points of a sunflower pattern, radians: they cover a disc evenly.
_GOLDEN_ANGLE = 2.399963

# Number of rays of near_edges on the disc's rim, which every straight edge in the disc cuts, and
# number of rays within it.
_RIM, _WITHIN = 8, 8


@loops_traced_once
@dr.syntax
def area_correction(
    scene: mi.Scene, p: mi.Point3f, n: mi.Normal3f, valid: mi.Bool, radius: float, seed: int
) -> mi.Float:
    """An estimate of π r² / A(x), (N,), where A(x) is the area on which photons count at x.

    Short rays, perpendicular to the disc, go through random points of the disc until one of them
    meets the surface. If a ray does so with probability c, the expected number of rays is 1/c. The
    number is limited to 8, which makes the mean too small by 0.4 % for c = 1/2 and by 10 % for
    c = 1/4.

    The ball around x cuts the same area from a curved surface, or from one with a crease, as from
    a plane (exactly so for a sphere). The disc is therefore treated as if it bent with the surface.
    Parts of the surface inside a box that stands on it, or behind a wall that crosses it, count
    like the rest.

    Parameters
    ----------
    p, n: positions and oriented normals, (N, 3).
    valid: points that take part, (N,); the result is 1 at all others.
    radius: kernel radius, world units.
    seed: a point's random numbers depend on the seed and the point's position alone.
    """
    r, frame = dr.opaque(mi.Float, radius), mi.Frame3f(n)
    first, second = _numbers_of(p, seed)
    trials, active = mi.UInt32(0), mi.Bool(valid)
    while dr.hint(active, exclude=[p, n, r, frame]):
        trials += 1
        first, second = mi.sample_tea_32(first, second)
        disc = mi.warp.square_to_uniform_disk(
            mi.Point2f(mi.Float(first >> 8), mi.Float(second >> 8)) * 2.0**-24
        )
        above = frame.to_world(r * mi.Vector3f(disc.x, disc.y, 1))
        active &= ~_lands(scene, p, n, r, above, False) & (trials < _MOST_TRIALS)
    return dr.select(valid, mi.Float(trials), 1)


@loops_traced_once
@dr.syntax
def ball_correction(
    scene: mi.Scene, p: mi.Point3f, valid: mi.Bool, radius: float, seed: int
) -> mi.Float:
    """An estimate of the volume of the kernel's ball, divided by that of the part of it that no
    surface hides from its centre, (N,): the number of random points until one can be seen.

    Arguments as for :func:`area_correction`.
    """
    r, (first, second) = dr.opaque(mi.Float, radius), _numbers_of(p, seed)
    start = dr.zeros(mi.Interaction3f, dr.width(p))
    start.p = p
    trials, active = mi.UInt32(0), mi.Bool(valid)
    while dr.hint(active, exclude=[p, r, start]):
        trials += 1
        first, second = mi.sample_tea_32(first, second)
        place = mi.Point2f(mi.Float(first >> 8), mi.Float(second >> 8)) * 2.0**-24
        first, second = mi.sample_tea_32(first, second)
        length = r * (mi.Float(first >> 8) * 2.0**-24) ** (1 / 3)
        beyond = p + length * mi.warp.square_to_uniform_sphere(place)
        hidden = scene.ray_test(start.spawn_ray_to(beyond), active)
        active &= hidden & (trials < _MOST_TRIALS_IN_BALL)
    return dr.select(valid, mi.Float(trials), 1)


@loops_traced_once
@dr.syntax
def covered_share(
    scene: mi.Scene, p: mi.Point3f, n: mi.Normal3f, radius: float, seed: int, rays: int
) -> mi.Float:
    """The part A(x) / π r² of the smooth kernel's disc on which photons count at x, (N,).

    Like :func:`area_correction`, but from a fixed number of rays spread evenly over the disc: the
    fraction of them that meet the surface, at least an eighth. Meant for the photons of
    :class:`gpf.photons.photon_grid.PhotonSums`, whose normals are rounded.
    """
    r, frame = dr.opaque(mi.Float, radius), mi.Frame3f(n)
    first, second = _numbers_of(p, seed)
    turn, shift = 2 * dr.pi * mi.Float(first >> 8) * 2.0**-24, mi.Float(second >> 8) * 2.0**-24
    count = dr.opaque(mi.UInt32, rays)
    number, hits = mi.UInt32(0), mi.UInt32(0)
    while dr.hint(number < count, exclude=[p, n, r, frame, turn, shift, count]):
        # The smooth kernel gives a point at the distance √s r the weight 2 (1 - s).
        s = (mi.Float(number) + shift) / mi.Float(count)
        above = _above(frame, r, dr.sqrt(1 - dr.sqrt(dr.maximum(1 - s, 0))), turn, number)
        hits += dr.select(_lands(scene, p, n, r, above, True), 1, 0)
        number += 1
    return dr.maximum(mi.Float(hits) / mi.Float(count), 1 / _MOST_TRIALS)


@loops_traced_once
@dr.syntax
def near_edges(scene: mi.Scene, p: mi.Point3f, n: mi.Normal3f, radius: float, seed: int) -> mi.Bool:
    """Whether the surface fails to fill the disc of this kernel, or of a smaller one, (N,).

    Edges that cut off less than 1.2 % of the disc may be missed.
    """
    r, frame = dr.opaque(mi.Float, radius), mi.Frame3f(n)
    first, _ = _numbers_of(p, seed)
    turn = 2 * dr.pi * mi.Float(first >> 8) * 2.0**-24
    number, filled = mi.UInt32(0), dr.full(mi.Bool, True, dr.width(p))
    while dr.hint(filled & (number < _RIM + _WITHIN), exclude=[p, n, r, frame, turn]):
        within = number >= _RIM
        place = dr.sqrt(dr.maximum(mi.Float(number) - (_RIM - 0.5), 0) / _WITHIN)
        on_rim = turn + mi.Float(number) * (2 * dr.pi / _RIM - _GOLDEN_ANGLE)
        distance, angle = dr.select(within, place, 0.98), dr.select(within, turn, on_rim)
        filled &= _lands(scene, p, n, r, _above(frame, r, distance, angle, number), True)
        number += 1
    return ~filled


def _numbers_of(p: mi.Point3f, seed: int) -> tuple[mi.UInt32, mi.UInt32]:
    """Two random numbers for each position, (N,) each."""
    key = dr.opaque(mi.UInt32, seed)
    bits = [dr.reinterpret_array(mi.UInt32, p[i]) for i in range(3)]
    first, second = mi.sample_tea_32(bits[0] ^ key, bits[1])
    return mi.sample_tea_32(first ^ bits[2], second)


def _above(
    frame: mi.Frame3f, r: mi.Float, distance: mi.Float, turn: mi.Float, number: mi.UInt32
) -> mi.Vector3f:
    """Offset of a ray's start, (N, 3): point ``number`` of a sunflower pattern rotated by ``turn``,
    at ``distance`` radii from its centre, one radius above the disc."""
    sine, cosine = dr.sincos(turn + _GOLDEN_ANGLE * mi.Float(number))
    return frame.to_world(r * mi.Vector3f(distance * cosine, distance * sine, 1))


@loops_traced_once
@dr.syntax
def _lands(
    scene: mi.Scene, p: mi.Point3f, n: mi.Normal3f, r: mi.Float, above: mi.Vector3f, rounded: bool
) -> mi.Bool:
    """Whether the surface below a place is the one ``p`` is on, so that photons there count, (N,).

    Parameters
    ----------
    above: offset of the place from ``p``, one radius above the disc, (N, 3).
    rounded: whether photons have rounded normals.
    """
    o, left = mi.Point3f(p + above), mi.Float(2 * r)
    found = dr.full(mi.Bool, False, dr.width(p))
    looking = left > 0
    while dr.hint(looking, exclude=[p, n, r]):  # glass may lie on the surface: go on below it
        ray = mi.Ray3f(o, -n, left, 0, mi.Color0f())
        si = scene.ray_intersect(ray, mi.RayFlags.Minimal, coherent=False, active=True)
        cosine = dr.abs(dr.dot(si.n, n))
        # The kernel's limit on height; the cosine accounts for the slope of the surface.
        flat = dr.abs(dr.dot(n, si.p - p)) * cosine <= SAME_SURFACE_HEIGHT * r
        if dr.hint(rounded, mode="scalar"):
            cosine = dr.abs(dr.dot(rounded_normal(si.n), n))
        found = si.is_valid() & flat & (cosine > SAME_SURFACE_COSINE)
        found &= mi.has_flag(si.bsdf().flags(), mi.BSDFFlags.Diffuse)
        step = dr.select(si.is_valid(), si.t + 1e-3 * r, left)
        o = ray(step)
        left -= step
        looking = ~found & (left > 0)
    return found

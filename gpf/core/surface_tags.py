"""Surface tags: a normal and a depth packed in one float, and the test for the same surface."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from gpf.core.spatial_hash import Record

# Surfaces whose normals differ by more than about 45° do not share photons: the other side of a
# thin wall and the wall around a corner are lit differently.
SAME_SURFACE_COSINE = 0.7

# Nor do surfaces share photons if one lies above the other by more than this fraction of the
# kernel's radius: the inside and the outside of a tube, the floor and the top of a thick carpet.
SAME_SURFACE_HEIGHT = 0.5

# The largest depth that a tag can hold; as a limit, it admits photons of any depth.
UNLIMITED = 255


def pack_tag(n: mi.Normal3f, depth: mi.UInt32 | int = 0) -> mi.Float:
    """A unit normal, 8 bits per coordinate, and a depth up to 255, as the bits of one float."""
    bits = mi.Vector3u(dr.round((n + 1) * 127.5))
    above = dr.minimum(mi.UInt32(depth), UNLIMITED) << 24
    return dr.reinterpret_array(mi.Float, bits.x | (bits.y << 8) | (bits.z << 16) | above)


def unpack_normal(tag: mi.Float) -> mi.Normal3f:
    """The normal in a tag; the error of each coordinate and of the length is at most 4e-3."""
    bits = dr.reinterpret_array(mi.UInt32, tag)
    packed = mi.Normal3f(
        mi.Float(bits & 255), mi.Float((bits >> 8) & 255), mi.Float((bits >> 16) & 255)
    )
    return packed * (1 / 127.5) - 1


def unpack_depth(tag: mi.Float) -> mi.UInt32:
    """The depth in a tag."""
    return dr.reinterpret_array(mi.UInt32, tag) >> 24


def same_orientation(record: Record, n: mi.Normal3f) -> mi.Bool:
    """Whether the normal in a record's tag is within about 45° of ``n``, (N,)."""
    return dr.dot(unpack_normal(record.tag), n) > SAME_SURFACE_COSINE


def same_surface(record: Record, p: mi.Point3f, n: mi.Normal3f, radius2: mi.Float) -> mi.Bool:
    """Whether a record lies on the surface that has the normal ``n`` at ``p``, (N,).

    Two conditions: the normals are similar (:func:`same_orientation`), and the record is close to
    the tangent plane at ``p``: ``|n · d| ≤ 0.5 r`` for the offset d from ``p`` to the record.

    Parameters
    ----------
    record: result of the neighbour search, with a tag from :func:`pack_tag`, (N,).
    radius2: squared kernel radius r², or, without a kernel, squared distance of the record, (N,).
    """
    d = record.p - p
    flat = dr.square(dr.dot(n, d)) <= SAME_SURFACE_HEIGHT**2 * radius2
    return flat & same_orientation(record, n)

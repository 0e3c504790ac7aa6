"""Tags of surface records: a normal and a depth in one float, and which records share a surface."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

# Two surfaces whose normals differ by more than about 45° do not share photons: the other side of
# a thin wall and the wall around a corner are in the dark about each other.
SAME_SURFACE_COSINE = 0.7

# Nor do those that lie above or below one another by more than this part of the kernel's radius:
# inside and outside of a tube, the floor and the top of a thick carpet.
SAME_SURFACE_HEIGHT = 0.5

# The greatest depth that a photon's tag tells, and a budget that admits photons of any depth.
UNLIMITED = 255


def pack_tag(n: mi.Normal3f, depth: mi.UInt32 | int = 0) -> mi.Float:
    """A unit normal (8 bits a coordinate) and a depth up to 255, as the bits of one float."""
    bits = mi.Vector3u(dr.round((n + 1) * 127.5))
    above = dr.minimum(mi.UInt32(depth), UNLIMITED) << 24
    return dr.reinterpret_array(mi.Float, bits.x | (bits.y << 8) | (bits.z << 16) | above)


def unpack_normal(tag: mi.Float) -> mi.Normal3f:
    """The normal in a tag, to 4e-3 a coordinate (the length, too)."""
    bits = dr.reinterpret_array(mi.UInt32, tag)
    packed = mi.Normal3f(
        mi.Float(bits & 255), mi.Float((bits >> 8) & 255), mi.Float((bits >> 16) & 255)
    )
    return packed * (1 / 127.5) - 1


def unpack_depth(tag: mi.Float) -> mi.UInt32:
    """The depth in a tag."""
    return dr.reinterpret_array(mi.UInt32, tag) >> 24


def same_orientation(record: mi.Vector4f, n: mi.Normal3f) -> mi.Bool:
    """Whether the normal in a record's tag is like ``n``."""
    return dr.dot(unpack_normal(record.w), n) > SAME_SURFACE_COSINE


def same_surface(record: mi.Vector4f, p: mi.Point3f, n: mi.Normal3f, radius2: mi.Float) -> mi.Bool:
    """Whether a record lies on the surface that has the normal ``n`` at ``p``.

    Its normal, which is in its tag, is like ``n``, and it lies near the plane through ``p``: by the
    measure of the kernel's squared radius, or of its own distance where that is more.
    """
    d = mi.Vector3f(record.x - p.x, record.y - p.y, record.z - p.z)
    scale2 = dr.maximum(radius2, dr.squared_norm(d))
    flat = dr.square(dr.dot(n, d)) <= SAME_SURFACE_HEIGHT**2 * scale2
    return flat & same_orientation(record, n)

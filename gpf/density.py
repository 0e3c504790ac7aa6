"""Photons and points -> irradiance: the radius schedule and the kernel density estimate."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.spatial_hash import SpatialHash
from gpf.structs import Photons

# Two surfaces whose normals differ by more than about 45° do not share photons: the other side of
# a thin wall and the wall around a corner are in the dark about each other.
SAME_SURFACE_COSINE = 0.7

# Nor do those that lie above or below one another by more than this part of the kernel's radius:
# inside and outside of a tube, the floor and the top of a thick carpet.
SAME_SURFACE_HEIGHT = 0.5

# The greatest depth that a photon's tag tells, and a budget that admits photons of any depth.
UNLIMITED = 255


def next_radius(radius: float, t: int, alpha: float) -> float:
    """r_{t+1} = r_t √((t + α) / (t + 1)), t counted from 1 (Knaus and Zwicker 2011)."""
    return float(radius * np.sqrt((t + alpha) / (t + 1)))


def radius_at(t: int, initial_radius: float, alpha: float) -> float:
    """Radius of pass ``t`` (from 1) in closed form, so that passes are independent given t.

    r_t² = r_1² Γ(t + α) / (Γ(1 + α) Γ(t + 1)) from the recurrence of :func:`next_radius`.
    """
    from scipy.special import gammaln

    log_ratio = gammaln(t + alpha) - gammaln(1 + alpha) - gammaln(t + 1)
    return float(initial_radius * np.exp(0.5 * log_ratio))


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


class PhotonDensity:
    """Photons sorted by place, and the irradiance that their density stands for anywhere:

        E(x) = 1 / (π r²) Σ κ(|x - x_i|² / r²) Φ_i    over photons on the same surface,

    with the kernel κ(s) = 1, or, where it is to be smooth, κ(s) = 2 (1 - s).

    Photons are added up cell by cell, and within a cell in the order in which they are given: the
    sums of photons in the same order are the same to the last bit.

    Parameters
    ----------
    photons: (M,).
    radius: kernel radius r, world units.
    bounds: corners of the scene's bounding box.
    smooth: whether a photon counts the less the farther away it is.
    """

    def __init__(self, photons: Photons, radius: float, bounds: Any, smooth: bool = False) -> None:
        self._smooth = smooth
        self._empty = dr.width(photons.p) == 0
        if self._empty:
            return
        # Narrow cells hold few photons outside of the ball, wide ones have few rows to walk.
        tag = pack_tag(photons.n, photons.depth)
        self._grid = SpatialHash(photons.p, cell=1.01 * radius, bounds=bounds, tag=tag)
        power = dr.gather(mi.Color3f, photons.power, self._grid.order)
        self._power = dr.ravel(mi.Vector4f(power.x, power.y, power.z, 0))
        dr.eval(self._power)
        self._radius = dr.opaque(mi.Float, radius)
        self._scale = dr.opaque(mi.Float, 1 / (math.pi * radius**2))

    def irradiance(
        self,
        p: mi.Point3f,
        n: mi.Normal3f,
        active: mi.Bool | bool = True,
        budget: mi.UInt32 | int = UNLIMITED,
    ) -> mi.Color3f:
        """E at points, W/m², (N, 3); 0 where they are not active.

        Parameters
        ----------
        p, n: positions and oriented normals, (N, 3).
        budget: greatest depth of a photon that a point accepts, (N,).
        """
        if self._empty:
            return dr.zeros(mi.Color3f, dr.width(p))
        radius2, limit = dr.square(self._radius), mi.UInt32(budget)

        def add(total, index, record, distance2, inside):  # type: ignore[no-untyped-def]
            counts = inside & same_surface(record, p, n, radius2)
            counts &= unpack_depth(record.w) <= limit
            power = dr.gather(mi.Vector4f, self._power, index, counts)
            color = mi.Color3f(power.x, power.y, power.z)
            if self._smooth:
                color *= 2 * (1 - distance2 / radius2)
            return total + color

        total = self._grid.visit(p, self._radius, add, mi.Color3f(0), mi.Bool(active))
        return total * self._scale

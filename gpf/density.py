"""Photons and points -> irradiance: the radius schedule and the kernel density estimate."""

from __future__ import annotations

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

# Bytes that the sums' copies, one per thread, may take.
_COPIES_LIMIT = 1 << 29

# A point with this depth budget takes photons of any depth.
UNLIMITED = 127


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


def pack_tag(
    n: mi.Normal3f, budget: mi.UInt32 | int = UNLIMITED, lit: mi.Bool | bool = False
) -> mi.Float:
    """A unit normal (8 bits a coordinate) and which photons count, as the bits of one float.

    Those count that are no deeper than ``budget`` (7 bits) and, where a point is ``lit`` already
    (1 bit), do not come straight from an emitter.
    """
    bits = mi.Vector3u(dr.round((n + 1) * 127.5))
    limits = dr.minimum(mi.UInt32(budget), UNLIMITED) | (mi.UInt32(mi.Bool(lit)) << 7)
    return dr.reinterpret_array(mi.Float, bits.x | (bits.y << 8) | (bits.z << 16) | (limits << 24))


def unpack_normal(tag: mi.Float) -> mi.Normal3f:
    """The normal in a tag, to 4e-3 a coordinate (the length, too)."""
    bits = dr.reinterpret_array(mi.UInt32, tag)
    packed = mi.Normal3f(
        mi.Float(bits & 255), mi.Float((bits >> 8) & 255), mi.Float((bits >> 16) & 255)
    )
    return packed * (1 / 127.5) - 1


def takes_depth(tag: mi.Float, depth: mi.UInt32) -> mi.Bool:
    """Whether photons of a depth count at the point that a tag belongs to."""
    limits = dr.reinterpret_array(mi.UInt32, tag) >> 24
    budget, lit = limits & UNLIMITED, (limits >> 7) == 1
    return ((depth <= budget) | (budget == UNLIMITED)) & ((depth > 0) | ~lit)


def same_surface(record: mi.Vector4f, p: mi.Point3f, n: mi.Normal3f, radius2: mi.Float) -> mi.Bool:
    """Whether a record lies on the surface that has the normal ``n`` at ``p``.

    Its normal, which is in its tag, is like ``n``, and it lies near the plane through ``p``: by the
    measure of the kernel's squared radius, or of its own distance where that is more.
    """
    d = mi.Vector3f(record.x - p.x, record.y - p.y, record.z - p.z)
    scale2 = dr.maximum(radius2, dr.squared_norm(d))
    flat = dr.square(dr.dot(n, d)) <= SAME_SURFACE_HEIGHT**2 * scale2
    return flat & (dr.dot(unpack_normal(record.w), n) > SAME_SURFACE_COSINE)


class IrradianceGatherer:
    """Irradiance at given points, summed up as photons land: nothing is stored but the sums.

    The hash holds the points, and each photon visits those within ``radius``:

        E(x) = 1 / (π r²) Σ Φ_i    over photons with |x - x_i| ≤ r on the same surface.

    Sorting some 10^5 points per pass costs less than storing and sorting several photons per path.
    Sums are whole numbers of ``unit``: they come out the same to the last bit in whatever order
    the threads add to them.

    Parameters
    ----------
    p, n: positions and oriented normals, (N, 3).
    valid: points that take part, (N,).
    budget: greatest depth of a photon that a point accepts, (N,), below :data:`UNLIMITED`.
    lit: points whose direct light is known already: photons of depth 0 do not count there, (N,).
    radius: kernel radius, world units.
    bounds: corners of the scene's bounding box.
    unit: what power is rounded to, W; see :func:`gpf.emission.power_unit`.
    """

    def __init__(
        self,
        p: mi.Point3f,
        n: mi.Normal3f,
        valid: mi.Bool,
        radius: float,
        bounds: Any,
        budget: mi.UInt32 | int = UNLIMITED,
        lit: mi.Bool | bool = False,
        unit: float = 2.0**-40,
    ) -> None:
        tag = pack_tag(n, budget, lit)
        cell = _cell_size(dr.width(p), radius, bounds)
        self.hash = SpatialHash(p, cell=cell, bounds=bounds, valid=valid, tag=tag)
        self._radius = dr.opaque(mi.Float, radius)
        self._unit = dr.opaque(mi.Float, unit)
        self._sums = dr.zeros(mi.UInt64, 4 * dr.width(p))
        # On the CPU, one copy of the sums per thread is many times as fast as atomics.
        copies = 32 * dr.width(p) * dr.thread_count()
        expand = dr.backend_v(mi.Float) == dr.JitBackend.LLVM and copies < _COPIES_LIMIT
        self._mode = dr.ReduceMode.Expand if expand else dr.ReduceMode.Auto

    def deposit(self, photons: Photons, active: mi.Bool) -> None:
        """Add the photons' power to the points around them; to be called from a photon walk."""
        radius2 = dr.square(self._radius)
        power = _four_sums()(mi.Vector4f(*photons.power, 0) / self._unit)

        def add(state, index, record, distance2, inside):  # type: ignore[no-untyped-def]
            counts = inside & same_surface(record, photons.p, photons.n, radius2)
            counts &= takes_depth(record.w, photons.depth)
            dr.scatter_reduce(dr.ReduceOp.Add, self._sums, power, index, counts, self._mode)
            return state

        self.hash.visit(photons.p, self._radius, add, mi.UInt32(0), active)

    def irradiance(self) -> mi.Color3f:
        """E, W/m², (N, 3); 0 at invalid points."""
        sums = mi.Vector4f(dr.gather(_four_sums(), self._sums, self.hash.slot))
        area = dr.pi * dr.square(self._radius)
        return mi.Color3f(sums.x, sums.y, sums.z) * (self._unit / area)


def _cell_size(points: int, radius: float, bounds: Any) -> float:
    """Edge of the cells in which photons look for points.

    Wide cells have few rows to walk, narrow ones few points that lie outside the ball: worth their
    rows where balls hold many points. How many that are is guessed as if the points were spread
    over one square of the scene's diagonal.
    """
    extent2 = sum((float(bounds[1][i]) - float(bounds[0][i])) ** 2 for i in range(3))
    crowd = points * radius**2 / max(extent2, 1e-30)
    return radius * (2.02 if crowd < 6 else 1.01 if crowd < 20 else 0.68)


def _four_sums() -> Any:
    """The type of four sums side by side, in the active variant."""
    return dr.uint64_array_t(mi.Vector4f)


def estimate_irradiance(photons: Photons, radius: float, bounds: Any) -> mi.Color3f:
    """Kernel density estimate of E at the photons' own positions, (N, 3).

    A photon counts itself, which makes the estimate positive everywhere.
    """
    grid = SpatialHash(photons.p, cell=2.02 * radius, bounds=bounds, tag=pack_tag(photons.n))
    power = dr.gather(mi.Color3f, photons.power, grid.order)
    power = dr.ravel(mi.Vector4f(power.x, power.y, power.z, 0))
    dr.eval(power)

    def add(total, index, record, distance2, inside):  # type: ignore[no-untyped-def]
        counts = inside & same_surface(record, photons.p, photons.n, radius2)
        value = dr.gather(mi.Vector4f, power, index, counts)
        return total + mi.Color3f(value.x, value.y, value.z)

    radius2 = dr.opaque(mi.Float, radius * radius)
    total = grid.visit(photons.p, dr.opaque(mi.Float, radius), add, mi.Color3f(0), mi.Bool(True))
    return total / (dr.pi * radius * radius)

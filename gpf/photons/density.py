"""The kernel density estimate of irradiance from photons."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi

from gpf.core.spatial_hash import SpatialHash
from gpf.core.structs import Haze, OrientedPoints, Photons
from gpf.core.surface_tags import UNLIMITED, pack_tag, same_surface, unpack_depth, unpack_normal
from gpf.scene.bounds import box_around
from gpf.scene.media import Place


class PhotonDensity:
    """Photons in a grid, and the estimate of irradiance from their density:

        E(x) = 1 / (π r²) Σ κ(|x - x_i|² / r²) Φ_i    over photons on the same surface,

    with the constant kernel κ(s) = 1 or the smooth kernel κ(s) = 2 (1 - s).

    Photons are added cell by cell, and in the given order within a cell, so that the same photons
    in the same order give the same bits.

    Parameters
    ----------
    photons: (M,).
    radius: kernel radius r, world units.
    bounds: corners of the scene's bounding box.
    smooth: whether to use the smooth kernel.
    """

    def __init__(self, photons: Photons, radius: float, bounds: Any, smooth: bool = False) -> None:
        self._smooth = smooth
        self._empty = dr.width(photons.p) == 0
        if self._empty:
            return
        # Narrower cells hold fewer photons outside the ball; wider cells mean fewer rows to visit.
        tag, cell = pack_tag(photons.n, photons.depth), 1.01 * radius
        self._grid = SpatialHash(photons.p, cell=cell, bounds=bounds, tag=tag, colour=photons.power)
        self._radius = dr.opaque(mi.Float, radius)
        self._scale = dr.opaque(mi.Float, 1 / (math.pi * radius**2))

    @classmethod
    def of_points(cls, points: OrientedPoints, radius: float, bounds: Any) -> PhotonDensity:
        """The density of points on surfaces, 1/m²: each point counts as a photon of one watt."""
        count = dr.width(points.p)
        power = mi.Color3f(dr.full(mi.Float, 1, count))
        depth = dr.zeros(mi.UInt32, count)
        return cls(Photons(p=points.p, n=points.n, power=power, depth=depth), radius, bounds)

    def irradiance(
        self,
        p: mi.Point3f,
        n: mi.Normal3f,
        active: mi.Bool | bool = True,
        budget: mi.UInt32 | int = UNLIMITED,
    ) -> mi.Color3f:
        """E at points, W/m², (N, 3); 0 at inactive points.

        Parameters
        ----------
        p, n: positions and oriented normals, (N, 3).
        budget: the greatest photon depth that each point accepts, (N,).
        """
        if self._empty:
            return dr.zeros(mi.Color3f, dr.width(p))
        radius2, limit = dr.square(self._radius), mi.UInt32(budget)

        def add(total, index, record, distance2, inside):  # type: ignore[no-untyped-def]
            counts = inside & same_surface(record, p, n, radius2)
            counts &= unpack_depth(record.tag) <= limit
            power = dr.select(counts, record.colour, 0)
            if self._smooth:
                power *= 2 * (1 - distance2 / radius2)
            return total + power

        total = self._grid.visit(p, self._radius, add, mi.Color3f(0), mi.Bool(active))
        return total * self._scale


class PhotonCloud:
    """Photons in media in a grid, and the estimate of scattered light from their density:

        ∫ f(ω, ω') L(x, ω') dω' = 3 / (4 π r³) Σ f(ω, ω_i) Φ_i    over photons within r.

    Parameters
    ----------
    photons: (M,).
    radius: kernel radius r, world units.

    Attributes
    ----------
    radius: the same; 0 if there are no photons.
    """

    def __init__(self, photons: Photons, radius: float) -> None:
        self.radius = radius if dr.width(photons.p) else 0.0
        if not self.radius:
            return
        # Fog without walls holds photons far beyond all surfaces.
        bounds = box_around(photons.p)
        tag, cell = pack_tag(photons.n, photons.depth), 1.01 * radius
        self._grid = SpatialHash(photons.p, cell=cell, bounds=bounds, tag=tag, colour=photons.power)
        self._radius = dr.opaque(mi.Float, radius)
        self._scale = dr.opaque(mi.Float, 3 / (4 * math.pi * radius**3))

    def scattered(self, haze: Haze, budget: mi.UInt32 | int = UNLIMITED) -> mi.Color3f:
        """The light scattered towards the camera, W/(m² sr), (N, 3); 0 at invalid places.

        ``budget``: the greatest photon depth that each place accepts, (N,).
        """
        if not self.radius:
            return dr.zeros(mi.Color3f, dr.width(haze.p))
        limit = mi.UInt32(budget)
        context = mi.PhaseFunctionContext()
        phase = haze.medium.phase_function()

        def add(total, index, record, distance2, inside):  # type: ignore[no-untyped-def]
            counts = inside & (unpack_depth(record.tag) <= limit)
            place = Place(haze.p, mi.Vector3f(dr.normalize(unpack_normal(record.tag))), haze.medium)
            share, _ = phase.eval_pdf(context, place.interaction(), -haze.d, counts)
            return total + dr.select(counts, share * record.colour, 0)

        total = self._grid.visit(haze.p, self._radius, add, mi.Color3f(0), haze.valid)
        return total * self._scale

    def fluence(
        self, p: mi.Point3f, active: mi.Bool | bool = True
    ) -> tuple[mi.Color3f, list[mi.Vector3f]]:
        """The first two moments of the radiance at places: the fluence φ, W/m², (N, 3), and for
        each channel φ times the mean direction of flight, (N, 3)."""
        if not self.radius:
            nothing = [dr.zeros(mi.Vector3f, dr.width(p)) for _ in range(3)]
            return dr.zeros(mi.Color3f, dr.width(p)), nothing

        def add(totals, index, record, distance2, inside):  # type: ignore[no-untyped-def]
            power = dr.select(inside, record.colour, 0)
            d = mi.Vector3f(unpack_normal(record.tag))
            return totals[0] + power, *(m + power[k] * d for k, m in enumerate(totals[1:]))

        start = mi.Color3f(0), mi.Vector3f(0), mi.Vector3f(0), mi.Vector3f(0)
        total, *moments = self._grid.visit(p, self._radius, add, start, mi.Bool(active))
        return total * self._scale, [moment * self._scale for moment in moments]

"""The part of the surfaces that lies near given points."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from gpf.core.spatial_hash import SpatialHash
from gpf.core.surface_tags import pack_tag, same_surface


class SurfacePatch:
    """The surface within ``radius`` of N points on it.

    Parameters
    ----------
    p, n: positions, and normals on one side of the surface, (N, 3).
    radius: world units.
    bounds: two opposite corners of a box around the points.
    """

    def __init__(
        self, p: mi.Point3f, n: mi.Normal3f, radius: float, bounds: tuple[Any, Any]
    ) -> None:
        self._radius = dr.opaque(mi.Float, radius)
        self._hash = SpatialHash(p, cell=2.02 * radius, bounds=bounds, tag=pack_tag(n))

    def contains(self, p: mi.Point3f, n: mi.Normal3f, active: mi.Bool | bool = True) -> mi.Bool:
        """Whether surface points (M, 3) with oriented normals (M, 3) lie in the patch, (M,)."""

        def look(found, index, record, distance2, inside):  # type: ignore[no-untyped-def]
            return found | (inside & same_surface(record, p, n, radius * radius))

        radius = self._radius
        return self._hash.visit(p, radius, look, mi.Bool(False), mi.Bool(active), enough=mi.Bool)

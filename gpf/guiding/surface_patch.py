"""The part of the surfaces that lies near given points."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.facing_cells import FacingCells
from gpf.core.spatial_hash import SpatialHash
from gpf.core.structs import from_numpy, to_numpy
from gpf.core.surface_tags import pack_tag, same_surface
from gpf.guiding.density_control import cell_keys

# One point is kept in each cell; a cell's edge is the radius divided by this.
_CELLS = 8


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
        # One of several close points is enough. In a room under an open sky, where the radius is
        # that of the surrounding land, a photon on a table leg would visit all of them.
        keys = cell_keys(to_numpy(p), to_numpy(n), radius / _CELLS)
        kept = from_numpy(mi.UInt32, np.unique(keys, return_index=True)[1].astype(np.uint32))
        p, n = dr.gather(mi.Point3f, p, kept), dr.gather(mi.Normal3f, n, kept)
        # On the outside of a wall, all the points on its inside would be visited in vain.
        self._facing = FacingCells(p, n, radius, bounds)
        self._hash = SpatialHash(p, cell=2.02 * radius, bounds=bounds, tag=pack_tag(n))

    def contains(self, p: mi.Point3f, n: mi.Normal3f, active: mi.Bool | bool = True) -> mi.Bool:
        """Whether surface points (M, 3) with oriented normals (M, 3) lie in the patch, (M,)."""

        def look(found, index, record, distance2, inside):  # type: ignore[no-untyped-def]
            return found | (inside & same_surface(record, p, n, radius * radius))

        radius, active = self._radius, self._facing.may_contain(p, n, mi.Bool(active))
        return self._hash.visit(p, radius, look, mi.Bool(False), active, enough=mi.Bool)

"""The Gaussians around points on surfaces, without those of other surfaces."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.facing_cells import FacingCells
from gpf.core.recordable import Recordable
from gpf.core.spatial_hash import NOT_FOUND, Body, Record, SpatialHash
from gpf.core.structs import from_numpy
from gpf.core.surface_tags import SAME_SURFACE_HEIGHT, pack_tag, same_orientation
from gpf.field.gaussians import Gaussians
from gpf.field.limits import SURFACE_HEIGHT
from gpf.field.settings import FieldSettings

# Radii of the supplement's first and largest search, in search radii: the first has twice the area
# of the ball. Where no Gaussian is within the largest, the field is black. Gaps that cameras see
# are filled before training (gpf.field.initialization.find_gaps).
FIRST_REACH = 1.4
LARGEST_REACH = 4.0

# Turns a missing plane into one that no point is beyond.
_BEYOND_ALL = np.array([0, 0, 0, 1e30], np.float32)


class NeighbourSearch(Recordable):
    """The Gaussians of a field, to be looked for.

    Parameters
    ----------
    bounds: two opposite corners of a box around the Gaussians.
    limits: the planes at which the Gaussians end, (N, 3, 4), or None (:mod:`gpf.field.limits`).

    Attributes
    ----------
    hash: the centres.
    radius: the search radius, (1,).
    """

    READ = ("hash", "radius", "_limits", "_facing")

    def __init__(
        self,
        gaussians: Gaussians,
        settings: FieldSettings,
        bounds: tuple[Any, Any],
        limits: np.ndarray | None,
    ) -> None:
        self.settings = settings
        self.hash = SpatialHash(
            gaussians.means,
            # Smaller cells than for photons: a candidate costs more here than a row of cells.
            cell=0.7 * settings.search_radius,
            bounds=bounds,
            tag=pack_tag(gaussians.normals),
            far=True,
        )
        reach = LARGEST_REACH * settings.search_radius
        self._facing = FacingCells(gaussians.means, gaussians.normals, reach, bounds)
        self._limits: tuple[mi.Float, ...] | None = None
        if limits is not None:
            free = ~np.any(limits[:, :, :3], axis=2, keepdims=True)
            ends = limits + free * _BEYOND_ALL
            self._limits = tuple(
                dr.ravel(dr.gather(mi.Vector4f, from_numpy(mi.Vector4f, v), self.hash.order))
                for v in ends.swapaxes(0, 1)
            )
            dr.eval(self._limits)
        self.radius = dr.opaque(mi.Float, settings.search_radius)

    def visit(self, x: mi.Point3f, n: mi.Normal3f, body: Body, state: Any, active: mi.Bool) -> Any:
        """Call ``body`` for at least the Gaussians in the ball that :meth:`accepts` admits; see
        :meth:`SpatialHash.visit`."""
        within = None
        if self.settings.normal_test:
            # They lie in a flat disc. This is half the size of a box around it.
            along = dr.minimum(dr.abs(mi.Vector3f(n)), 1)
            within = self.radius * (dr.sqrt(1 - along * along) + SURFACE_HEIGHT * along)
        return self.hash.visit(x, self.radius, body, state, active, within=within)

    def accepts(self, record: Record, p: mi.Point3f, n: mi.Normal3f) -> mi.Bool:
        """Whether the Gaussian of a record belongs to the surface with normal ``n`` at ``p``."""
        if not self.settings.normal_test:
            return mi.Bool(True)
        d = record.p - p
        radius2 = dr.square(self.radius)
        beyond2 = dr.maximum(dr.squared_norm(d) - radius2, 0)
        limit2 = SURFACE_HEIGHT**2 * radius2 + SAME_SURFACE_HEIGHT**2 * beyond2
        flat = dr.square(dr.dot(n, d)) <= limit2
        return flat & same_orientation(record, n)

    def reaches(self, index: mi.UInt32, p: mi.Point3f, active: mi.Bool) -> mi.Bool:
        """Whether the Gaussians at ``index``, in the order of the search, do not end before ``p``;
        false where inactive."""
        if self._limits is None:
            return active
        before = mi.Bool(active)
        for planes in self._limits:
            plane = dr.gather(mi.Vector4f, planes, index, active)
            before &= dr.dot(mi.Vector3f(plane.x, plane.y, plane.z), p) < plane.w
        return before

    @dr.syntax
    def nearest(self, x, n, active):  # type: ignore[no-untyped-def]
        """The k + 1 nearest Gaussians, as :meth:`SpatialHash.nearest` returns them; none is
        farther than :data:`LARGEST_REACH`. Where all of them end before a point, as in a niche
        without any of its own, they are used anyway; but not in media, which are dark there."""
        if dr.hint(self.settings.normal_test, mode="scalar"):
            active = self._facing.may_contain(x, n, active)
        radii = FIRST_REACH * self.radius, LARGEST_REACH * self.radius
        count = self.settings.k + 1

        def search(active, everyone):  # type: ignore[no-untyped-def]
            def accept(index, record, inside):  # type: ignore[no-untyped-def]
                inside = inside & self.accepts(record, x, n)
                return inside & (everyone | self.reaches(index, x, inside))

            return self.hash.nearest(x, count, *radii, accept, active)

        if dr.hint(self._limits is None or not self.settings.normal_test, mode="scalar"):
            return search(active, mi.Bool(self._limits is None))
        index = [mi.UInt32(NOT_FOUND)] * count
        distance2 = [mi.Float(dr.inf)] * count
        everyone = mi.Bool(False)
        searching = mi.Bool(active)
        while dr.hint(searching, exclude=[x, n, active]):
            index, distance2 = search(searching, everyone)
            searching &= (distance2[0] == dr.inf) & ~everyone
            everyone = mi.Bool(True)
        return index, distance2

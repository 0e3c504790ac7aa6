"""How far away the nearest points are."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.spatial_hash import Accept, SpatialHash
from gpf.core.structs import to_numpy


def measure_spacing(
    points: mi.Point3f,
    x: mi.Point3f,
    k: int,
    bounds: tuple[Any, Any],
    percentile: float = 50,
    limit: float = 1,
    tag: mi.Float | None = None,
    accept: Accept | None = None,
) -> float:
    """A percentile, by default the median, of the distance from places to the k-th nearest of some
    points, world units; infinite if there are fewer.

    Parameters
    ----------
    points: (N, 3).
    x: the places, (M, 3).
    limit: how far to look, in units of the diagonal of the bounds.
    bounds, tag, accept: as for :class:`gpf.core.spatial_hash.SpatialHash` and its ``nearest``.
    """
    if dr.width(points) < k:
        return np.inf
    places = to_numpy(x)
    # About the diagonal of a room that the places are in, whatever they see beyond its windows.
    size = 3 * float(np.median(np.linalg.norm(places - np.median(places, axis=0), axis=1)))
    extent = float(dr.norm(bounds[1] - bounds[0]))
    size = min(max(size, 1e-6 * extent), extent) or 1.0
    grid = SpatialHash(points, cell=1e-2 * size, bounds=bounds, far=True, tag=tag)
    # Opaque, so that the kernel is compiled once.
    start, end = (dr.opaque(mi.Float, d) for d in (2e-3 * size, limit * grid.levels.extent))
    _, distance2 = grid.nearest(x, k, start, end, accept)
    # Without a mean of two, which may be infinite.
    return float(np.sqrt(np.percentile(distance2[k - 1].numpy(), percentile, method="higher")))

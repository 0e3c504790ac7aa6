"""Neighbour lists of supervised points: the Gaussians that a query visits, kept for many steps."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.structs import SurfacePoints, to_numpy
from gpf.field.field import GaussianPhotonField, supplement_support
from gpf.field.gaussians import Gaussians

# Radius of the lists, in search radii: Gaussians move a little until the next rebuild, and the
# lists include those that may enter the ball.
LIST_MARGIN = 1.1


@dataclass
class NeighbourLists:
    """Lists of Gaussians for P points, as compressed rows.

    Attributes
    ----------
    starts: start of each point's list in ``indices``, and the end of the last, (P + 1,).
    indices: Gaussians, numbered as in ``field.gaussians``, (pairs,).
    support2: squared support R² of the blend's falloff at each point, (P,).
    """

    starts: mi.UInt32
    indices: mi.UInt32
    support2: mi.Float


@dr.syntax
def _list_neighbours(field, points, fill, indices, offset, dense):  # type: ignore[no-untyped-def]
    """Count the neighbours of each point; with ``fill``, also write them from ``offset`` on.

    Only the balls of ``dense`` points are visited: the list of a sparse point has no room for all
    Gaussians within the margin.
    """
    settings = field.settings
    radius = dr.opaque(mi.Float, settings.search_radius)
    listed = dr.opaque(mi.Float, settings.search_radius * LIST_MARGIN)
    radius2 = radius * radius
    order = field.hash.order

    def write(index, slot, active):  # type: ignore[no-untyped-def]
        if fill:
            original = dr.gather(mi.UInt32, order, index, active)
            dr.scatter(indices, original, slot, active)

    def add(state, index, record, distance2, inside):  # type: ignore[no-untyped-def]
        within, count = state
        inside &= field.accepts(record, points.p, points.n)
        inside = field.reaches(index, points.p, inside)
        write(index, offset + count, inside)
        near = inside & (distance2 <= radius2)
        return within + dr.select(near, 1, 0), count + dr.select(inside, 1, 0)

    within = mi.UInt32(0)
    count = mi.UInt32(0)
    active = dr.full(mi.Bool, True, dr.width(points.p)) & dense
    if dr.hint(settings.neighbours != "knn", mode="scalar"):
        within, count = field.hash.visit(points.p, listed, add, (within, count), active)
    support2 = dr.full(mi.Float, 1, dr.width(points.p)) * radius2
    sparse = mi.Bool(False)
    if dr.hint(settings.neighbours != "radius", mode="scalar"):
        sparse = within <= settings.k
        index, distance2 = field.supplement(points.p, points.n, sparse)
        _, reach2 = supplement_support(distance2)
        found = mi.UInt32(0)
        for j in range(settings.k):
            exists = sparse & (distance2[j] < dr.inf)
            write(index[j], offset + found, exists)
            found += dr.select(exists, 1, 0)
        count = dr.select(sparse, found, count)
        support2 = dr.select(sparse, reach2, support2)
    return count, support2, ~sparse


def list_neighbours(field: GaussianPhotonField, points: SurfacePoints) -> NeighbourLists:
    """The Gaussians that :meth:`GaussianPhotonField.query` blends at each point, and those nearby
    (:data:`LIST_MARGIN`)."""
    none = dr.zeros(mi.UInt32, 1)
    count, support2, dense = _list_neighbours(
        field, points, False, none, mi.UInt32(0), mi.Bool(True)
    )
    dr.eval(count, support2, dense)
    ends = dr.prefix_reduce(dr.ReduceOp.Add, count, exclusive=False)
    starts = dr.concat([mi.UInt32(0), ends])
    pairs = int(ends[dr.width(ends) - 1])
    indices = dr.zeros(mi.UInt32, max(pairs, 1))
    offset = dr.gather(mi.UInt32, starts, dr.arange(mi.UInt32, dr.width(points.p)))
    filled, _, _ = _list_neighbours(field, points, True, indices, offset, dense)
    dr.eval(filled, indices, starts)
    return NeighbourLists(starts, indices, support2)


def local_targets(
    gaussians: Gaussians, points: SurfacePoints, radius: float, neighbours: int = 8
) -> np.ndarray:
    """Mean target of the supervised points nearest to each Gaussian on its surface, (N, 3).

    The distance includes the normals: a right angle between them adds 1.4 ``radius`` (world units)
    and the other side of a thin wall adds 2. Otherwise points inside a lamp would count for
    Gaussians on its outside.
    """

    from scipy.spatial import cKDTree  # slow to import

    def places(p: mi.Point3f, n: mi.Normal3f) -> np.ndarray:
        return np.hstack([to_numpy(p), radius * to_numpy(n)])

    count = min(neighbours, dr.width(points.p))
    tree = cKDTree(places(points.p, points.n))
    _, near = tree.query(places(gaussians.means, gaussians.normals), k=count)
    near = near.reshape(-1, count)
    # Where points are sparse, those on the other side of a thin wall are among the nearest.
    facing = np.einsum("nkc,nc->nk", to_numpy(points.n)[near], to_numpy(gaussians.normals)) > 0
    facing[~facing.any(axis=1)] = True
    target = np.where(facing[:, :, None], to_numpy(points.target)[near], 0)
    return target.sum(axis=1) / facing.sum(axis=1, keepdims=True)

"""Neighbour lists of supervised points: the Gaussians that a query visits, kept for many steps."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.machine import count_cores
from gpf.core.structs import SurfacePoints, concatenate, to_numpy
from gpf.field.field import GaussianPhotonField, supplement_support
from gpf.field.gaussians import Gaussians
from gpf.field.limits import before

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

# Radius of the lists, in search radii: Gaussians move a little until the next rebuild, and the
# lists include those that may enter the ball.
LIST_MARGIN = 1.1

# If not all of the nearest points are on a Gaussian's surface, the search is repeated among this
# many times as many.
_AMONG = 6

# Largest height of a point above a Gaussian on the same surface, in search radii.
_HEIGHT = 0.1


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
    order = field.search.hash.order

    def write(index, slot, active):  # type: ignore[no-untyped-def]
        if fill:
            original = dr.gather(mi.UInt32, order, index, active)
            dr.scatter(indices, original, slot, active)

    def add(state, index, record, distance2, inside):  # type: ignore[no-untyped-def]
        within, count = state
        inside &= field.search.accepts(record, points.p, points.n)
        inside = field.search.reaches(index, points.p, inside)
        write(index, offset + count, inside)
        near = inside & (distance2 <= radius2)
        return within + dr.select(near, 1, 0), count + dr.select(inside, 1, 0)

    within = mi.UInt32(0)
    count = mi.UInt32(0)
    active = dr.full(mi.Bool, True, dr.width(points.p)) & dense
    if dr.hint(settings.neighbours != "knn", mode="scalar"):
        within, count = field.search.hash.visit(points.p, listed, add, (within, count), active)
    support2 = dr.full(mi.Float, 1, dr.width(points.p)) * radius2
    sparse = mi.Bool(False)
    if dr.hint(settings.neighbours != "radius", mode="scalar"):
        sparse = within <= settings.k
        index, distance2 = field.search.nearest(points.p, points.n, sparse)
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
    starts = concatenate([mi.UInt32(0), ends])
    pairs = int(ends[dr.width(ends) - 1])
    indices = dr.zeros(mi.UInt32, max(pairs, 1))
    offset = dr.gather(mi.UInt32, starts, dr.arange(mi.UInt32, dr.width(points.p)))
    filled, _, _ = _list_neighbours(field, points, True, indices, offset, dense)
    dr.eval(filled, indices, starts)
    return NeighbourLists(starts, indices, support2)


def local_targets(
    gaussians: Gaussians,
    points: SurfacePoints,
    radius: float,
    limits: np.ndarray | None = None,
    neighbours: int = 8,
) -> np.ndarray:
    """Mean target of the supervised points nearest to each Gaussian on its surface, (N, 3).

    The distance includes the normals: a right angle between them adds 1.4 ``radius`` (world units)
    and the other side of a thin wall adds 2. Otherwise points inside a lamp would count for
    Gaussians on its outside. If there are any points on the same surface, others do not count:
    those beyond the Gaussian's ``limits`` (:mod:`gpf.field.limits`), and those above or below it
    along the mean of both normals. On a round surface that height is zero. Where no near point is
    on the same surface, behind a wall, say, the values of the nearest Gaussians on it count: they
    lie less densely, so that as many of them reach farther.
    """
    means, normals = to_numpy(gaussians.means), to_numpy(gaussians.normals)
    every = np.arange(len(means))
    places = _Places(means, normals, radius, limits)
    p, n, target = (to_numpy(v) for v in (points.p, points.n, points.target))
    values = _Values(p, n, target, radius)
    found, share = places.mean(every, values, neighbours, neighbours)
    rest = every[share < 1]
    if len(rest):
        found[rest], share[rest] = places.mean(rest, values, neighbours, _AMONG * neighbours)
    known, rest = every[share > 0], every[share == 0]
    if len(known) and len(rest):
        values = _Values(means[known], normals[known], found[known], radius)
        mean, share = places.mean(rest, values, neighbours, _AMONG * neighbours)
        found[rest] = np.where(share[:, None] > 0, mean, found[rest])
    return found


@dataclass
class _Values:
    """Values at points with normals, (N, 3) each."""

    p: np.ndarray
    n: np.ndarray
    values: np.ndarray
    radius: float

    @cached_property
    def tree(self) -> cKDTree:
        """Finds the nearest."""
        from scipy.spatial import cKDTree  # slow to import

        return cKDTree(np.hstack([self.p, self.radius * self.n]))


@dataclass
class _Places:
    """Where Gaussians are, and where they end."""

    means: np.ndarray
    normals: np.ndarray
    radius: float
    limits: np.ndarray | None

    def mean(
        self, rows: np.ndarray, known: _Values, neighbours: int, among: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """The means of up to ``neighbours`` of the ``among`` points nearest to some Gaussians, and
        the share of those points that is on each Gaussian's surface."""
        means, normals = self.means[rows], self.normals[rows]
        among = min(among, len(known.p))
        here = np.hstack([means, self.radius * normals])
        _, near = known.tree.query(here, k=among, workers=count_cores())
        near = near.reshape(-1, among)
        x, facing = known.p[near], known.n[near]
        # Where points are sparse, those on the other side of a thin wall are among the nearest.
        counts = np.einsum("nkc,nc->nk", facing, normals) > 0
        offset = x - means[:, None]
        height = np.einsum("nkc,nkc->nk", facing + normals[:, None], offset) / 2
        farthest = np.maximum(self.radius, np.linalg.norm(offset, axis=2))
        own = counts & (np.abs(height) <= _HEIGHT * farthest)
        if self.limits is not None:
            own &= before(self.limits[rows], x)
        share = own.mean(axis=1)
        counts = np.where(share[:, None] > 0, own, counts)
        counts[~counts.any(axis=1)] = True
        counts &= np.cumsum(counts, axis=1) <= neighbours
        found = np.where(counts[:, :, None], known.values[near], 0)
        return found.sum(axis=1) / counts.sum(axis=1, keepdims=True), share

"""Groups of nearby photons, with the moments that expectation maximisation needs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from scipy.spatial import cKDTree


@dataclass(frozen=True)
class PhotonCells:
    """Moments of C groups of photons, each photon weighted by its power; float64.

    Cells of several passes are joined and neighbouring cells are merged, so photons need not be
    kept: memory and time depend only on the number of cells.

    Attributes
    ----------
    count: number of photons, (C,).
    flux: sum of their powers Φ_i, W, (C, 3).
    means: Σ ω_i x_i / Σ ω_i, where ω_i is the mean of Φ_i's channels, (C, 3).
    covariances: Σ ω_i (x_i - mean)(x_i - mean)ᵀ / Σ ω_i, (C, 3, 3).
    """

    count: np.ndarray
    flux: np.ndarray
    means: np.ndarray
    covariances: np.ndarray

    def __len__(self) -> int:
        return len(self.count)

    @property
    def mass(self) -> np.ndarray:
        """Σ ω_i, (C,)."""
        return np.asarray(self.flux.mean(axis=1))


def single_photons(
    positions: np.ndarray, powers: np.ndarray, bandwidth: float = 0.0
) -> PhotonCells:
    """One cell per photon with power, from positions (N, 3) and powers (N, 3).

    Each photon is a Gaussian kernel with the standard deviation ``bandwidth``, world units.
    """
    bears = powers.mean(axis=1) > 0
    x, flux = positions[bears].astype(np.float64), powers[bears].astype(np.float64)
    kernel = bandwidth**2 * np.eye(3)
    return PhotonCells(np.ones(len(x)), flux, x, np.tile(kernel, (len(x), 1, 1)))


def join_cells(parts: Sequence[PhotonCells]) -> PhotonCells:
    """All cells of several sets of photons."""
    names = [f.name for f in fields(PhotonCells)]
    return PhotonCells(*(np.concatenate([getattr(part, n) for part in parts]) for n in names))


def coarsen_cells(cells: PhotonCells, most: int) -> PhotonCells:
    """At most ``most`` cells: those below each node of a kd-tree are merged.

    All nodes have the same depth d, so there are 2^d of them.
    """
    if len(cells) <= most:
        return cells
    order, starts = kd_runs(cells.means, 1 << (most.bit_length() - 1))
    return merge_runs(cells, order, starts)


def kd_runs(points: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The order of points (N, 3) by a kd-tree's leaves, (N,), and the starts of ``count`` nodes.

    Nodes are halved at the median of their longest axis until there are ``count`` <= N. If that is
    not a power of two, the nodes with the largest extent are halved once more.
    """
    depth = count.bit_length() - 1
    leaf = max(1, len(points) >> (depth + 1))
    order = np.asarray(cKDTree(points, leafsize=leaf).indices)
    bounds = np.array([0, len(points)])
    for _ in range(depth):
        bounds = np.insert(bounds, range(1, len(bounds)), (bounds[:-1] + bounds[1:]) // 2)
    starts, ends = bounds[:-1], bounds[1:]
    if further := count - len(starts):
        x = points[order]
        extent = np.maximum.reduceat(x, starts) - np.minimum.reduceat(x, starts)
        halvable = np.where(ends - starts > 1, np.linalg.norm(extent, axis=1), -1)
        chosen = np.argsort(-halvable, kind="stable")[:further]
        starts = np.sort(np.append(starts, ((starts + ends) // 2)[chosen]))
    return order, starts


def merge_runs(cells: PhotonCells, order: np.ndarray, starts: np.ndarray) -> PhotonCells:
    """Merge each run of cells, in this order, into one; ``starts`` has each run's beginning."""
    which = np.repeat(np.arange(len(starts)), np.diff(starts, append=len(order)))

    def add(values: np.ndarray) -> np.ndarray:
        return np.add.reduceat(values, starts)

    omega = cells.mass[order]
    mass = add(omega)
    means = add(omega[:, None] * cells.means[order]) / mass[:, None]
    # About the new mean: with squares of large coordinates, rounding would destroy thin cells.
    d = cells.means[order] - means[which]
    spread = cells.covariances[order] + d[:, :, None] * d[:, None, :]
    covariances = add(omega[:, None, None] * spread) / mass[:, None, None]
    return PhotonCells(add(cells.count[order]), add(cells.flux[order]), means, covariances)

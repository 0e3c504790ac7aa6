"""The power density of a Gaussian mixture at points in space."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from baselines.em_gmm.gaussian_mixture import GaussianMixture
from gpf.core.structs import from_numpy

# Gaussians end at this many standard deviations; a thousandth of their power lies beyond.
CUTOFF = 4.0

# Upper limit of the entries in all cells' lists; with more, the cells are made larger.
_MOST_ENTRIES = 1 << 23


class MixtureDensity:
    """Σ_s Φ_s g_s(x), watts per cubic world unit; each g_s integrates to 1 over the volume.

    Each cell of a grid lists the components that reach into it. A search for component centres
    would need the radius of the largest component, and their sizes differ by orders of magnitude.

    Parameters
    ----------
    mixture: K components.
    bounds: two opposite corners of the grid's box; points outside use the nearest border cell.
    """

    def __init__(self, mixture: GaussianMixture, bounds: tuple[Any, Any]) -> None:
        variances, axes = np.linalg.eigh(mixture.covariances)
        deviations = np.sqrt(variances)
        lower, upper = (np.array([corner[i] for i in range(3)], float) for corner in bounds)
        edge = float(np.median(deviations[:, -1]))
        while True:
            shape = np.maximum(np.ceil((upper - lower) / edge).astype(np.int64), 1)
            reach = CUTOFF * np.sqrt(np.diagonal(mixture.covariances, axis1=1, axis2=2))
            first = ((mixture.means - reach - lower) / edge).clip(0, shape - 1).astype(np.int64)
            last = ((mixture.means + reach - lower) / edge).clip(0, shape - 1).astype(np.int64)
            if max((last - first + 1).prod(axis=1).sum(), shape.prod()) <= _MOST_ENTRIES:
                break
            edge *= 1.5
        cell, component = _overlaps(mixture.means - lower, deviations, axes, first, last, edge)
        index = (cell[:, 2] * shape[1] + cell[:, 1]) * shape[0] + cell[:, 0]
        order = np.argsort(index, kind="stable")
        starts = np.concatenate([[0], np.cumsum(np.bincount(index, minlength=shape.prod()))])
        self._starts = from_numpy(mi.UInt32, starts)
        self._members = from_numpy(mi.UInt32, component[order])

        rows = np.swapaxes(axes / deviations[:, None, :], 1, 2)
        peak = mixture.flux / ((2 * np.pi) ** 1.5 * deviations.prod(axis=1))[:, None]
        packets = np.concatenate([rows, peak[:, :, None]], axis=2).astype(np.float32)
        self._packets = [from_numpy(mi.Float, packets[:, k].ravel()) for k in range(3)]
        self._means = from_numpy(mi.Float, np.pad(mixture.means, ((0, 0), (0, 1))).ravel())
        self._lower = mi.Point3f(*(dr.opaque(mi.Float, v) for v in lower))
        self._scale = dr.opaque(mi.Float, 1 / edge)
        self._last = mi.Vector3f(*(dr.opaque(mi.Float, int(n) - 1) for n in shape))
        self._stride = [dr.opaque(mi.UInt32, int(n)) for n in shape[:2]]

    @dr.syntax
    def __call__(self, x: mi.Point3f, active: mi.Bool | bool = True) -> mi.Color3f:
        """The density at points (N, 3), (N, 3); 0 for inactive points."""
        c = mi.Vector3u(dr.clip((x - self._lower) * self._scale, 0, self._last))
        cell = (c.z * self._stride[1] + c.y) * self._stride[0] + c.x
        entry = dr.gather(mi.UInt32, self._starts, cell, active)
        end = dr.gather(mi.UInt32, self._starts, cell + 1, active)
        total = mi.Color3f(0)
        while active & (entry < end):
            index = dr.gather(mi.UInt32, self._members, entry, active)
            mean = dr.gather(mi.Vector4f, self._means, index, active)
            d = x - mi.Point3f(mean.x, mean.y, mean.z)
            packets = [dr.gather(mi.Vector4f, p, index, active) for p in self._packets]
            u = mi.Vector3f(*(dr.dot(mi.Vector3f(p.x, p.y, p.z), d) for p in packets))
            total += dr.exp(-0.5 * dr.squared_norm(u)) * mi.Color3f(*(p.w for p in packets))
            entry += 1
        return dr.select(active, total, 0)


def _overlaps(
    means: np.ndarray,
    deviations: np.ndarray,
    axes: np.ndarray,
    first: np.ndarray,
    last: np.ndarray,
    edge: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of cells (P, 3) and components (P,) that reach into them, ordered by component.

    The cells are those in each component's box from ``first`` to ``last`` (K, 3), except those that
    are beyond the ellipsoid along one of its axes.
    """
    size = last - first + 1
    counts = size.prod(axis=1)
    component = np.repeat(np.arange(len(means)), counts)
    local = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    x, y = size[component, 0], size[component, 1]
    cell = first[component] + np.stack([local % x, local // x % y, local // (x * y)], axis=1)
    d = (cell + 0.5) * edge - means[component]
    along = np.abs(np.einsum("pi,pij->pj", d, axes[component]))
    reach = CUTOFF * deviations + 0.5 * edge * np.abs(axes).sum(axis=1)
    meets = (along <= reach[component]).all(axis=1)
    return cell[meets], component[meets]

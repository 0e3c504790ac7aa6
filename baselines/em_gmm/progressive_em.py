"""A Gaussian mixture that improves with each portion of photons."""

from __future__ import annotations

import numpy as np

from baselines.em_gmm.gaussian_mixture import (
    GaussianMixture,
    improve_mixture,
    initialize_mixture,
)
from baselines.em_gmm.photon_cells import coarsen_cells, join_cells, single_photons

# The proposed bandwidth in units of a component's initial standard deviation, and its lower limit
# in units of the diagonal of the photons' bounding box.
_NARROW = 0.5
_NARROWEST = 1e-4


class ProgressiveMixture:
    """Progressive expectation maximisation (Jakob, Regg and Jarosz 2011).

    Photons are added in portions. Each photon becomes a cell; if there are too many cells,
    neighbours are merged, and only their moments are kept. Then a few steps of EM continue from the
    last mixture, over the cells of all photons so far. Responsibilities are always those of the
    newest mixture, as in the incremental EM of Neal and Hinton, so early photons need no discount.
    The first mixture is a level of the cells' kd-tree.

    Every photon is a Gaussian kernel with the standard deviation ε, the ``bandwidth``, so no
    variance is below ε². Without kernels the likelihood has no maximum: a component within a plane
    always gains by becoming thinner.

    Parameters
    ----------
    components: number of Gaussians K; at most the number of photons in the first portion.
    bandwidth: ε, world units; None for :func:`propose_bandwidth` of the first portion.
    cells: upper limit of the cells per component.
    steps: upper limit of EM steps after each portion.
    tolerance: EM stops when a step gains less than this, nats.

    Attributes
    ----------
    mixture: the current mixture; None before there are photons. Its flux is the sum of all powers.
    photons: the number of photons so far.
    bound: F per photon (:func:`baselines.em_gmm.gaussian_mixture.improve_mixture`), nats.
    """

    def __init__(
        self,
        components: int,
        bandwidth: float | None = None,
        cells: int = 8,
        steps: int = 5,
        tolerance: float = 2e-3,
    ) -> None:
        self.components, self.bandwidth = components, bandwidth
        self.steps, self.tolerance = steps, tolerance
        self.mixture: GaussianMixture | None = None
        self.photons = 0
        self.bound = -np.inf
        self._most = cells * components
        self._cells = single_photons(np.zeros((0, 3)), np.zeros((0, 3)))

    def add(self, positions: np.ndarray, powers: np.ndarray) -> None:
        """Add photons, positions and powers (N, 3), and improve the mixture."""
        if not (powers > 0).any():
            return
        if self.bandwidth is None:
            self.bandwidth = propose_bandwidth(positions, self.components)
        new = single_photons(positions, powers, self.bandwidth)
        self.photons += len(new)
        self._cells = coarsen_cells(join_cells([self._cells, new]), self._most)
        if self.mixture is None:
            self.mixture = initialize_mixture(self._cells, self.components)
        self.mixture, history = improve_mixture(
            self.mixture, self._cells, self.steps, self.tolerance
        )
        self.bound = history[-1]


def propose_bandwidth(positions: np.ndarray, components: int) -> float:
    """Half of a typical component's largest standard deviation before EM; world units."""
    cells = single_photons(positions, np.ones_like(positions))
    start = initialize_mixture(cells, components)
    typical = float(np.median(np.linalg.eigvalsh(start.covariances)[:, -1].clip(0)) ** 0.5)
    diagonal = float(np.linalg.norm(np.ptp(positions, axis=0)))
    return max(_NARROW * typical, _NARROWEST * diagonal, float(np.finfo(np.float32).tiny))

"""A Gaussian mixture that is fitted while photons come in."""

from __future__ import annotations

import numpy as np

from gpf.baselines.em_gmm.gaussian_mixture import (
    GaussianMixture,
    improve_mixture,
    initialize_mixture,
)
from gpf.baselines.em_gmm.photon_cells import coarsen_cells, join_cells, single_photons

# The proposed bandwidth, in units of what a component begins with; at the least, in units of the
# diagonal of the box around the photons.
_NARROW = 0.5
_NARROWEST = 1e-4


class ProgressiveMixture:
    """Progressive expectation maximisation (Jakob, Regg and Jarosz 2011).

    Photons are added in several portions. Each becomes a cell of its own; while there are more
    cells than wanted, those side by side are merged, and their photons forgotten but for their
    moments. Then a few steps of EM go on from the last mixture, over the cells of all photons so
    far: responsibilities are always those of the newest mixture, as in the incremental EM of Neal
    and Hinton, and nothing that was learned from early photons has to be discounted. The first
    mixture is a level of the cells' kd-tree.

    Every photon stands for a Gaussian kernel of the standard deviation ε, the ``bandwidth``, and
    so no covariance is below ε². Without that, the likelihood has no maximum: a component within a
    plane gains by becoming thinner, forever.

    Parameters
    ----------
    components: number of Gaussians K; with fewer photons in the first portion, as many as those.
    bandwidth: ε, world units; None is :func:`propose_bandwidth` of the first portion.
    cells: kept for each component, at most.
    steps: of EM after each portion, at most.
    tolerance: gain in nats below which no further step is made.

    Attributes
    ----------
    mixture: the current one, None before there are photons. Its flux is the sum of all powers.
    photons: how many have been added.
    bound: F per photon (:func:`gpf.baselines.em_gmm.gaussian_mixture.improve_mixture`), in nats.
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
        """Learn from further photons: positions and powers, (N, 3)."""
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
    """Half of the largest standard deviation of a typical component, before EM; world units."""
    cells = single_photons(positions, np.ones_like(positions))
    start = initialize_mixture(cells, components)
    typical = float(np.median(np.linalg.eigvalsh(start.covariances)[:, -1].clip(0)) ** 0.5)
    diagonal = float(np.linalg.norm(np.ptp(positions, axis=0)))
    return max(_NARROW * typical, _NARROWEST * diagonal, float(np.finfo(np.float32).tiny))

"""Expectation maximisation of Gaussian mixtures, on single photons or on cells of photons."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.spatial import cKDTree

from baselines.em_gmm.photon_cells import PhotonCells, kd_runs, merge_runs

# The six different entries of a symmetric matrix, and how often each occurs.
_ROWS, _COLUMNS = (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)
_TIMES = np.array([1, 1, 1, 2, 2, 2])

# A component is a candidate for the cells within this many of its largest standard deviations. It
# is kept where its share is at least e^-10 of the largest share.
_REACH = 3.5
_FAINTEST = -10.0

# Every cell has at least this many candidates, at any distance.
_AT_LEAST = 8

_BLOCK = 1 << 14


@dataclass(frozen=True)
class GaussianMixture:
    """K Gaussians in space, float64.

    Attributes
    ----------
    weights: shares w of the photons' power, (K,); their sum is 1.
    means: μ, (K, 3).
    covariances: Σ, (K, 3, 3).
    flux: power Φ of the photons of each Gaussian, W, (K, 3).
    """

    weights: np.ndarray
    means: np.ndarray
    covariances: np.ndarray
    flux: np.ndarray

    def __len__(self) -> int:
        return len(self.weights)


def initialize_mixture(cells: PhotonCells, components: int) -> GaussianMixture:
    """One Gaussian per node of a level of the cells' kd-tree, with the moments of its photons.

    There are ``components`` Gaussians, or one per cell if there are fewer cells.
    """
    order, starts = kd_runs(cells.means, min(components, len(cells)))
    nodes = merge_runs(cells, order, starts)
    weights = nodes.mass / nodes.mass.sum()
    return GaussianMixture(weights, nodes.means, nodes.covariances, nodes.flux)


def improve_mixture(
    mixture: GaussianMixture,
    cells: PhotonCells,
    steps: int,
    tolerance: float = 0.0,
    exact: bool = False,
) -> tuple[GaussianMixture, list[float]]:
    """Run up to ``steps`` steps of EM; stop when a step gains less than ``tolerance``.

    All photons of a cell A have the same responsibilities (Verbeek, Nunnink and Vlassis 2006):

        E: q_A(s) ∝ w_s exp(<log g_s(x)>_A),
           <log g_s(x)>_A = log g_s(m_A) - ½ tr(Σ_s⁻¹ C_A),    m_A, C_A: the cell's moments
        M: n_s = Σ_A ω_A q_A(s),    w_s = n_s / Σ_s n_s,    μ_s = Σ_A ω_A q_A(s) m_A / n_s,
           Σ_s = Σ_A ω_A q_A(s) (C_A + (m_A - μ_s)(m_A - μ_s)ᵀ) / n_s

    Neither step lowers F = Σ_A ω_A log Σ_s w_s exp(<log g_s(x)>_A) / Σ_A ω_A. F is a lower bound of
    the log-likelihood; they are equal if every cell is one photon, which is plain EM.

    Parameters
    ----------
    exact: use all components for every cell instead of the nearby ones. The nearby ones are chosen
        once, before the first step.

    Returns
    -------
    The mixture, without components that have no photons nearby; and F before the first step and
    after each step, in nats.
    """
    origin = np.average(cells.means, axis=0, weights=cells.mass)
    moments = _moments(cells, origin)
    candidates = _all_pairs(mixture, cells) if exact else _near_pairs(mixture, cells)
    joint = _log_joint(mixture, moments, origin, candidates)
    if not exact:
        joint = _without_faint(joint)
    history = []
    while True:
        shares, likelihoods = _expect(joint)
        history.append(float(np.average(likelihoods, weights=cells.mass)))
        done = len(history) > steps or (len(history) > 1 and history[-1] - history[-2] < tolerance)
        if done:
            return mixture, history
        mixture, joint = _maximize(shares, cells, moments, origin)
        joint = _log_joint(mixture, moments, origin, joint)


def _moments(cells: PhotonCells, origin: np.ndarray) -> np.ndarray:
    """Sufficient statistics <(1, x, xxᵀ)> of each cell, about the origin, (C, 10)."""
    x = cells.means - origin
    second = x[:, _ROWS] * x[:, _COLUMNS] + cells.covariances[:, _ROWS, _COLUMNS]
    return np.concatenate([np.ones((len(x), 1)), x, second], axis=1)


def _parameters(mixture: GaussianMixture, origin: np.ndarray) -> np.ndarray:
    """θ_s with log w_s g_s(x) = θ_s · (1, x, xxᵀ), x about the origin, (K, 10)."""
    precision = np.linalg.inv(mixture.covariances)
    _, log_det = np.linalg.slogdet(mixture.covariances)
    mean = mixture.means - origin
    linear = np.einsum("kij,kj->ki", precision, mean)
    constant = np.log(mixture.weights) - 0.5 * (
        log_det + 3 * np.log(2 * np.pi) + (linear * mean).sum(axis=1)
    )
    second = -0.5 * _TIMES * precision[:, _ROWS, _COLUMNS]
    return np.concatenate([constant[:, None], linear, second], axis=1)


def _near_pairs(mixture: GaussianMixture, cells: PhotonCells) -> csr_array:
    """The candidate components of each cell, as stored entries, (C, K)."""
    reach = _REACH * np.sqrt(np.linalg.eigvalsh(mixture.covariances)[:, -1])
    near = cKDTree(cells.means).query_ball_point(mixture.means, reach, workers=-1)
    sizes = [len(found) for found in near]
    least = min(_AT_LEAST, len(mixture))
    _, nearest = cKDTree(mixture.means).query(cells.means, np.arange(1, least + 1), workers=-1)
    cell = np.concatenate([*near, np.repeat(np.arange(len(cells)), least)]).astype(np.int64)
    component = np.append(np.repeat(np.arange(len(mixture)), sizes), nearest.ravel())
    pairs = coo_array((np.ones(len(cell)), (cell, component)), shape=(len(cells), len(mixture)))
    return pairs.tocsr()


def _all_pairs(mixture: GaussianMixture, cells: PhotonCells) -> csr_array:
    return csr_array(np.ones((len(cells), len(mixture))))


def _log_joint(
    mixture: GaussianMixture, moments: np.ndarray, origin: np.ndarray, pairs: csr_array
) -> csr_array:
    """log w_s + <log g_s>_A where ``pairs`` has entries."""
    parameters = _parameters(mixture, origin)
    cell = np.repeat(np.arange(len(moments)), np.diff(pairs.indptr))
    values = np.empty(pairs.nnz)
    # In blocks, so that gathered rows stay in the processor's cache.
    for first in range(0, pairs.nnz, _BLOCK):
        block = slice(first, first + _BLOCK)
        left = moments.take(cell[block], axis=0)
        right = parameters.take(pairs.indices[block], axis=0)
        values[block] = np.einsum("pj,pj->p", left, right)
    return csr_array((values, pairs.indices, pairs.indptr), shape=pairs.shape)


def _without_faint(joint: csr_array) -> csr_array:
    """Only the entries of at least ``_FAINTEST`` relative to the cell's largest entry."""
    sizes = np.diff(joint.indptr)
    greatest = np.maximum.reduceat(joint.data, joint.indptr[:-1])
    matters = joint.data - np.repeat(greatest, sizes) >= _FAINTEST
    starts = np.concatenate([[0], np.cumsum(matters)])[joint.indptr]
    return csr_array((joint.data[matters], joint.indices[matters], starts), shape=joint.shape)


def _expect(joint: csr_array) -> tuple[csr_array, np.ndarray]:
    """Responsibilities q_A(s), and log Σ_s exp(joint) of each cell."""
    sizes = np.diff(joint.indptr)
    greatest = np.maximum.reduceat(joint.data, joint.indptr[:-1])
    values = np.exp(joint.data - np.repeat(greatest, sizes))
    total = np.add.reduceat(values, joint.indptr[:-1])
    shares = csr_array((values / np.repeat(total, sizes), joint.indices, joint.indptr), joint.shape)
    return shares, greatest + np.log(total)


def _maximize(
    shares: csr_array, cells: PhotonCells, moments: np.ndarray, origin: np.ndarray
) -> tuple[GaussianMixture, csr_array]:
    """The mixture that fits the shares best, without empty components, and its shares."""
    sums = shares.T @ np.concatenate([cells.mass[:, None] * moments, cells.flux], axis=1)
    mass = sums[:, 0]
    alive = np.flatnonzero(mass > 0)
    if len(alive) < len(mass):
        sums, mass, shares = sums[alive], mass[alive], shares[:, alive]
    means = sums[:, 1:4] / mass[:, None]
    second = sums[:, 4:10] / mass[:, None] - means[:, _ROWS] * means[:, _COLUMNS]
    covariances = np.empty((len(mass), 3, 3))
    covariances[:, _ROWS, _COLUMNS] = second
    covariances[:, _COLUMNS, _ROWS] = second
    return GaussianMixture(mass / mass.sum(), means + origin, covariances, sums[:, 10:]), shares

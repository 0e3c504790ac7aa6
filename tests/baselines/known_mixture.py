"""A mixture whose parameters are known, photons drawn from it, and densities by brute force."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import multivariate_normal

from baselines.em_gmm.gaussian_mixture import GaussianMixture

WEIGHTS = np.array([0.4, 0.3, 0.2, 0.1])
MEANS = np.array([[0.0, 0.2, 0.1], [1.6, -0.3, 0.4], [0.4, 1.9, -0.6], [-0.9, -0.8, 1.7]])
# Standard deviations along axes that are turned by so many degrees about x, y and z.
DEVIATIONS = np.array([[0.5, 0.1, 0.3], [0.2, 0.6, 0.1], [0.3, 0.3, 0.1], [0.15, 0.4, 0.25]])
ANGLES = np.array([[10, 40, -30], [-60, 20, 80], [0, 35, 15], [50, -20, 5]])
# Power per photon: a photon of the third component is three times as bright as the others.
POWERS = np.array([[1, 2, 3], [3, 2, 1], [9, 6, 3], [2, 2, 2]]) * 1e-4


def known_mixture() -> GaussianMixture:
    turns = Rotation.from_euler("xyz", ANGLES, degrees=True).as_matrix()
    covariances = np.einsum("kij,kj,klj->kil", turns, DEVIATIONS**2, turns)
    return GaussianMixture(WEIGHTS, MEANS, covariances, np.zeros((4, 3)))


def draw_photons(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Positions and powers, (N, 3): numbers follow weight over brightness, powers the weights."""
    rng = np.random.default_rng(seed)
    share = WEIGHTS / POWERS.mean(axis=1)
    which = rng.choice(4, count, p=share / share.sum())
    factors = np.linalg.cholesky(known_mixture().covariances)
    noise = rng.normal(size=(count, 3))
    return MEANS[which] + np.einsum("nij,nj->ni", factors[which], noise), POWERS[which]


def densities(mixture: GaussianMixture, x: np.ndarray) -> np.ndarray:
    """Of all components at points (N, 3), (N, K)."""
    each = zip(mixture.means, mixture.covariances, strict=True)
    return np.stack([multivariate_normal(m, c).pdf(x) for m, c in each], axis=1)


def log_likelihood(mixture: GaussianMixture, x: np.ndarray, powers: np.ndarray) -> float:
    """Per photon, weighted by power, in nats."""
    total = densities(mixture, x) @ mixture.weights
    return float(np.average(np.log(total), weights=powers.mean(axis=1)))

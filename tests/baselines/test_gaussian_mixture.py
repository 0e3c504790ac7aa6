"""Mixtures in a volume, where the method is at home: what photons were drawn from comes back."""

from __future__ import annotations

import numpy as np
import pytest

from baselines.em_gmm.gaussian_mixture import (
    GaussianMixture,
    improve_mixture,
    initialize_mixture,
)
from baselines.em_gmm.photon_cells import single_photons
from baselines.em_gmm.progressive_em import ProgressiveMixture
from tests.baselines.known_mixture import (
    POWERS,
    WEIGHTS,
    densities,
    draw_photons,
    known_mixture,
    log_likelihood,
)


def fit_portions(
    portions: int, components: int, count: int = 40_000, **options: float
) -> ProgressiveMixture:
    fit = ProgressiveMixture(components, **options)  # type: ignore[arg-type]
    x, powers = draw_photons(count, seed=1)
    for k in range(portions):
        fit.add(x[k::portions], powers[k::portions])
    return fit


def matched(mixture: GaussianMixture) -> np.ndarray:
    """Which component is nearest to each known one."""
    distance = np.linalg.norm(mixture.means[None] - known_mixture().means[:, None], axis=2)
    nearest = distance.argmin(axis=1)
    assert len(set(nearest.tolist())) == 4
    return nearest


def test_a_known_mixture_is_recovered_from_five_portions():
    fit = fit_portions(5, 4, bandwidth=0.01, cells=4096, steps=30, tolerance=1e-6)
    found, known = fit.mixture, known_mixture()
    order = matched(found)
    np.testing.assert_allclose(found.weights[order], WEIGHTS, atol=0.005)
    np.testing.assert_allclose(found.means[order], known.means, atol=0.02)
    error = np.linalg.norm(found.covariances[order] - known.covariances, axis=(1, 2))
    assert (error / np.linalg.norm(known.covariances, axis=(1, 2)) < 0.06).all()
    deviations = np.sqrt(np.linalg.eigvalsh(found.covariances[order]))
    expected = np.sqrt(np.linalg.eigvalsh(known.covariances))
    np.testing.assert_allclose(deviations, expected, rtol=0.05)


def test_flux_follows_the_colours_of_the_photons():
    fit = fit_portions(5, 4, bandwidth=0.01, cells=4096, steps=30, tolerance=1e-6)
    _, powers = draw_photons(40_000, seed=1)
    np.testing.assert_allclose(fit.mixture.flux.sum(axis=0), powers.sum(axis=0), rtol=1e-9)
    colours = POWERS / POWERS.mean(axis=1, keepdims=True)
    expected = powers.mean(axis=1).sum() * WEIGHTS[:, None] * colours
    np.testing.assert_allclose(fit.mixture.flux[matched(fit.mixture)], expected, rtol=0.08)


def test_plain_em_never_lowers_the_likelihood():
    x, powers = draw_photons(3000, seed=2)
    cells = single_photons(x, powers)
    mixture = initialize_mixture(cells, 7)
    likelihoods = [log_likelihood(mixture, x, powers)]
    for _ in range(25):
        mixture, bound = improve_mixture(mixture, cells, steps=1, exact=True)
        likelihoods.append(log_likelihood(mixture, x, powers))
        # Where each photon is a cell of its own, the bound is the likelihood itself.
        np.testing.assert_allclose(bound, likelihoods[-2:], rtol=1e-9)
    assert (np.diff(likelihoods) > -1e-10).all()
    assert likelihoods[-1] > likelihoods[0] + 0.1


def test_cells_bound_the_likelihood_and_never_fall():
    x, powers = draw_photons(20_000, seed=3)
    fit = ProgressiveMixture(30, bandwidth=1e-3, cells=20, steps=0)
    fit.add(x, powers)
    mixture, bound = improve_mixture(fit.mixture, fit._cells, steps=12, exact=True)
    assert (np.diff(bound) > -1e-10).all()
    likelihood = log_likelihood(mixture, x, powers)
    assert bound[-1] <= likelihood
    assert bound[-1] > likelihood - 0.1


@pytest.mark.parametrize("portions", [1, 6])
def test_progressive_em_reaches_the_likelihood_of_plain_em(portions):
    """Within 0.015 nats a photon, on photons that neither has seen and on those that both have."""
    x, powers = draw_photons(6000, seed=1)
    cells = single_photons(x, powers, 0.01)
    plain, _ = improve_mixture(initialize_mixture(cells, 24), cells, steps=40, exact=True)
    fit = fit_portions(portions, 24, 6000, bandwidth=0.01, cells=100, steps=40, tolerance=0)
    for photons in (draw_photons(20_000, seed=9), (x, powers)):
        best = log_likelihood(plain, *photons)
        assert log_likelihood(fit.mixture, *photons) == pytest.approx(best, abs=0.015)


def test_near_components_do_as_well_as_all():
    x, powers = draw_photons(8000, seed=4)
    cells = single_photons(x, powers, 0.02)
    start = initialize_mixture(cells, 150)
    exact, _ = improve_mixture(start, cells, steps=3, exact=True)
    near, bound = improve_mixture(start, cells, steps=3)
    assert (np.diff(bound) > -1e-10).all()
    apart = np.abs(densities(near, x) @ near.weights / (densities(exact, x) @ exact.weights) - 1)
    assert np.mean(apart) < 0.015


def test_many_components_give_the_density():
    """The likelihood ratio to the truth is a divergence: 0 for the truth itself."""
    fit = fit_portions(5, 64, 60_000, bandwidth=0.02, cells=64)
    x, powers = draw_photons(20_000, seed=9)
    divergence = log_likelihood(known_mixture(), x, powers) - log_likelihood(fit.mixture, x, powers)
    assert 0 < divergence < 0.03


def test_components_are_as_many_as_there_are_photons_at_most():
    x, powers = draw_photons(5, seed=5)
    fit = ProgressiveMixture(100)
    fit.add(x, 0 * powers)
    assert fit.mixture is None
    fit.add(x, powers)
    assert len(fit.mixture) <= 5
    np.testing.assert_allclose(fit.mixture.weights.sum(), 1)
    assert np.isfinite(fit.mixture.covariances).all()


def test_photons_in_one_place_have_a_bandwidth_nevertheless():
    fit = ProgressiveMixture(3)
    fit.add(np.full((8, 3), 0.5), np.ones((8, 3)))
    assert fit.bandwidth > 0
    assert np.isfinite(np.linalg.inv(fit.mixture.covariances)).all()


def test_shifted_and_turned_photons_give_a_shifted_and_turned_mixture():
    x, powers = draw_photons(4000, seed=6)
    turn, shift = np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]]), np.array([100.0, -50.0, 20.0])
    first, second = ProgressiveMixture(32, cells=30), ProgressiveMixture(32, cells=30)
    first.add(x, powers)
    second.add(x @ turn.T + shift, powers)
    np.testing.assert_allclose(
        second.mixture.means, first.mixture.means @ turn.T + shift, atol=1e-6
    )
    turned = turn @ first.mixture.covariances @ turn.T
    np.testing.assert_allclose(second.mixture.covariances, turned, atol=1e-7)

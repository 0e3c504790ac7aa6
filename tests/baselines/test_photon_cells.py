from __future__ import annotations

import numpy as np
import pytest

from baselines.em_gmm.photon_cells import (
    coarsen_cells,
    join_cells,
    kd_runs,
    merge_runs,
    single_photons,
)


def photons(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.uniform([0, 0, 0], [4, 2, 1], (count, 3)), rng.uniform(0.5, 2, (count, 3))


def test_moments_of_merged_cells_are_those_of_their_photons():
    x, powers = photons(60)
    order = np.random.default_rng(1).permutation(60)
    starts = np.array([0, 7, 8, 40])
    once = merge_runs(single_photons(x, powers), order, starts)
    # Of cells that were merged before, too.
    pairs = merge_runs(single_photons(x, powers), order, np.array([0, 3, 7, 8, 20, 31, 40, 55]))
    twice = merge_runs(pairs, np.arange(8), np.array([0, 2, 3, 6]))
    for k, members in enumerate(np.split(order, starts[1:])):
        weights = powers[members].mean(axis=1)
        mean = np.average(x[members], axis=0, weights=weights)
        d = x[members] - mean
        covariance = np.einsum("n,ni,nj->ij", weights, d, d) / weights.sum()
        for cells in (once, twice):
            assert cells.count[k] == len(members)
            np.testing.assert_allclose(cells.flux[k], powers[members].sum(axis=0))
            np.testing.assert_allclose(cells.means[k], mean)
            np.testing.assert_allclose(cells.covariances[k], covariance, atol=1e-14)


def test_thin_cells_far_from_the_origin_stay_thin():
    x, powers = photons(1000)
    x = x * [1, 1, 0] + [1e4, 2e4, 3e4]
    merged = coarsen_cells(single_photons(x, powers, bandwidth=1e-3), 16)
    np.testing.assert_allclose(merged.covariances[:, 2, 2], 1e-6, rtol=1e-9)


def test_a_kernel_adds_to_the_covariance():
    x, powers = photons(3)
    cells = single_photons(x, powers, bandwidth=0.2)
    np.testing.assert_allclose(cells.covariances, np.tile(0.04 * np.eye(3), (3, 1, 1)))


def test_photons_without_power_are_left_out():
    x, powers = photons(5)
    powers[[1, 3]] = 0
    np.testing.assert_array_equal(single_photons(x, powers).means, x[[0, 2, 4]])


@pytest.mark.parametrize("count", [1, 2, 5, 16, 23])
def test_nodes_of_the_tree_hold_all_points_and_lie_apart(count):
    x, _ = photons(200)
    order, starts = kd_runs(x, count)
    assert sorted(order.tolist()) == list(range(200))
    assert len(starts) == count and starts[0] == 0 and (np.diff(starts) > 0).all()
    boxes = [(x[node].min(axis=0), x[node].max(axis=0)) for node in np.split(order, starts[1:])]
    for i, (lower, upper) in enumerate(boxes):
        for other_lower, other_upper in boxes[:i]:
            assert ((lower > other_upper) | (upper < other_lower)).any()


def test_cells_are_few_and_local():
    x, powers = photons(3000)
    many = join_cells(
        [single_photons(x[:1000], powers[:1000]), single_photons(x[1000:], powers[1000:])]
    )
    few = coarsen_cells(many, 300)
    assert len(few) == 256
    assert few.count.sum() == 3000
    assert set(few.count) == {11, 12}
    spread = np.sqrt(np.trace(few.covariances, axis1=1, axis2=2))
    assert np.median(spread) < 0.25
    assert coarsen_cells(few, 256) is few

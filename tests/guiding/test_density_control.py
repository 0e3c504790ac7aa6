"""Photons where cameras seldom look survive with a chance, and stand for those that did not."""

import mitsuba as mi
import numpy as np
import pytest

from gpf.core.structs import Photons, from_numpy, to_numpy
from gpf.guiding.density_control import (
    MAX_RATIO,
    cell_keys,
    control_density,
    count_in_cells,
    oriented_places,
)


def test_counts_are_those_of_a_histogram():
    rng = np.random.default_rng(0)
    at, first, second = (rng.normal(size=(n, 3)) * (1, 2, 0.3) for n in (50, 700, 90))
    counted = count_in_cells(at, 0.4, first, second)
    for points, counts in zip((first, second), counted, strict=True):
        cells = [tuple(c) for c in np.floor(points / 0.4).astype(int)]
        expected = [cells.count(tuple(c)) for c in np.floor(at / 0.4).astype(int)]
        assert counts.tolist() == expected


def test_cells_are_told_apart_however_many_there_are():
    """A room of two metres with a view of ten kilometres, in cells of .01 mm."""
    rng = np.random.default_rng(3)
    p = rng.normal(size=(3000, 3)) * np.where(rng.random(3000) < 0.1, 1e4, 1)[:, None]
    p, n = np.repeat(p, 2, axis=0), rng.normal(size=(6000, 3))
    places = np.floor(oriented_places(p, n, 1e-5) / 1e-5)
    _, expected = np.unique(places, axis=0, return_inverse=True)
    _, found = np.unique(cell_keys(p, n, 1e-5), return_inverse=True)
    np.testing.assert_array_equal(found, expected.ravel())
    (counts,) = count_in_cells(p, 1e-5, p)
    assert (counts == 2).all()


def test_points_that_none_looks_at_count_none():
    (counts,) = count_in_cells(np.array([[0.1, 0.1, 0.1], [9, 9, 9]]), 1.0, np.zeros((3, 3)))
    assert counts.tolist() == [3, 0]


def make_photons(p: np.ndarray, up: np.ndarray | bool = True) -> Photons:
    count = len(p)
    z = np.where(np.broadcast_to(up, count), 1, -1)
    return Photons(
        p=from_numpy(mi.Point3f, p),
        n=from_numpy(mi.Normal3f, np.stack([0 * z, 0 * z, z], axis=1)),
        power=from_numpy(mi.Color3f, np.full((count, 3), 0.5)),
        depth=from_numpy(mi.UInt32, np.zeros(count)),
    )


def test_photons_inside_a_lamp_are_fewer_and_the_others_all_stay():
    """Nine tenths of the photons in a corner that gets a hundredth of the looks."""
    rng = np.random.default_rng(1)
    aside = np.array([5.0, 0, 0])
    flat = np.array([1, 1, 0])
    lamp, room = rng.random((90_000, 3)) * flat, rng.random((10_000, 3)) * flat + aside
    seen = rng.random((500, 3)) * flat, rng.random((49_500, 3)) * flat + aside
    looks = np.concatenate(seen)
    photons = make_photons(np.concatenate([lamp, room]))
    kept = control_density(photons, make_photons(looks), width=1.0, seed=3)
    p, power = to_numpy(kept.p), to_numpy(kept.power)
    inside = p[:, 0] < 2
    share = MAX_RATIO * 0.01 / 0.9
    assert inside.sum() == pytest.approx(90_000 * share, rel=0.05)
    assert (~inside).sum() == 10_000
    np.testing.assert_allclose(power[~inside], 0.5)
    np.testing.assert_allclose(power[inside], 0.5 / share, rtol=1e-4)
    assert power[inside].sum() == pytest.approx(3 * 0.5 * 90_000, rel=0.05)


def test_the_few_photons_outside_a_lamp_all_stay():
    """In the same place, but on the other side of a thin wall."""
    rng = np.random.default_rng(2)
    inside, outside = np.full(50_000, True), np.full(50, False)
    wall = rng.random((50_050, 3)) * (1, 1, 0)
    photons = make_photons(wall, np.concatenate([inside, outside]))
    looks = make_photons(rng.random((5000, 3)) * (1, 1, 0), rng.random(5000) < 0.1)
    kept = control_density(photons, looks, width=2.0, seed=3)
    up = to_numpy(kept.n)[:, 2] > 0
    assert (~up).sum() == 50
    assert up.sum() == pytest.approx(50_000 * min(1, MAX_RATIO * 0.1), rel=0.05)


def test_surfaces_over_each_other_have_cells_of_their_own():
    """A tilted plane in one cell of the grid, and another one a quarter of the cell over it."""
    rng = np.random.default_rng(0)
    n = np.array([0.3, -0.2, 1]) / np.linalg.norm([0.3, -0.2, 1])
    flat = np.column_stack([rng.uniform(0.2, 0.8, (200, 2)), np.zeros(200)])
    flat[:, 2] = 0.45 - (flat[:, :2] - 0.5) @ n[:2] / n[2]
    both = np.concatenate([flat[:150], flat[150:] + 0.25 * n])
    places = oriented_places(both, np.tile(n, (200, 1)), 1.0)
    (counts,) = count_in_cells(places, 1.0, places)
    np.testing.assert_array_equal(counts, np.repeat([150, 50], [150, 50]))

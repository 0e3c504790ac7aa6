"""The choice of levels: coarse where light is smooth or noisy, fine where it is sharp."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from gpf.core.structs import SurfacePoints, from_numpy
from gpf.training.detail_choice import FINEST, LEVELS, choose_detail, fit_linear

BOX = mi.ScalarPoint3f(0, 0, 0), mi.ScalarPoint3f(2, 2, 0.1)
COUNT, KERNEL = 60_000, 0.02


def make_points(light, noise: float, count: int = COUNT):
    """Points on a square, with targets from two halves that have noise of their own."""
    rng = np.random.default_rng(0)
    p = np.column_stack([rng.uniform(0, 2, (count, 2)), np.zeros(count)])
    n = np.tile([0.0, 0.0, 1.0], (count, 1))
    truth = light(p)[:, None] * np.ones(3)
    halves = [truth + noise * np.sqrt(2) * rng.normal(size=truth.shape) for _ in range(2)]
    sets = [
        SurfacePoints(
            from_numpy(mi.Point3f, p),
            from_numpy(mi.Normal3f, n),
            from_numpy(mi.Color3f, target),
        )
        for target in ((halves[0] + halves[1]) / 2, *halves)
    ]
    return sets[0], (sets[1], sets[2]), p


def levels(light, noise: float, count: int = COUNT) -> tuple[np.ndarray, np.ndarray]:
    """The level at each point, and the points."""
    points, halves, p = make_points(light, noise, count)
    detail = choose_detail(points, halves, KERNEL, BOX)
    assert detail.radius == pytest.approx(FINEST * KERNEL * 2 ** (LEVELS - 1))
    return detail.levels_at(p), p


def test_smooth_light_is_coarse():
    found, _ = levels(lambda p: 1 + 0.2 * p[:, 0] - 0.1 * p[:, 1], 0.1)
    assert (found == 0).mean() > 0.8


def test_ripples_are_fine_where_they_are():
    def light(p):
        return 1 + 0.5 * np.sin(2 * np.pi * p[:, 0] / 0.12) * (p[:, 1] > 1)

    found, p = levels(light, 0.1)
    assert np.median(found[p[:, 1] > 1.3]) >= 3
    assert np.median(found[p[:, 1] < 0.7]) == 0


def test_what_drowns_in_noise_is_not_learned():
    def light(p):
        return 1 + 0.05 * np.sin(2 * np.pi * p[:, 0] / 0.12)

    clear, _ = levels(light, 0.005)
    noisy, _ = levels(light, 2.0)
    assert np.median(clear) >= 3 and np.median(noisy) == 0


def test_a_linear_function_is_fitted_exactly_where_points_are_many():
    rng = np.random.default_rng(1)
    p = np.column_stack([rng.uniform(0, 1, (5000, 2)), np.zeros(5000)])
    n = np.tile([0.0, 0.0, 1.0], (5000, 1))
    values = np.stack([2 * p[:, 0] - p[:, 1], 3 + p[:, 1]], axis=1)
    np.testing.assert_allclose(fit_linear(p, n, values, 0.25)[0], values, atol=0.01)


def test_surfaces_with_different_orientations_are_fitted_apart():
    rng = np.random.default_rng(2)
    p = rng.uniform(0, 1, (4000, 3))
    n = np.where(np.arange(4000)[:, None] % 2, [0.0, 0.0, 1.0], [0.0, 0.0, -1.0])
    values = n[:, 2:]
    np.testing.assert_allclose(fit_linear(p, n, values, 0.5)[0], values, atol=1e-5)


def test_a_point_does_not_count_for_itself():
    """The fit at a point is that of the other points in its cell."""
    rng = np.random.default_rng(3)
    p = np.column_stack([rng.uniform(0, 1, (60, 2)), np.zeros(60)])
    n = np.tile([0.0, 0.0, 1.0], (60, 1))
    values = rng.uniform(0, 1, (60, 1))
    changed = values.copy()
    changed[7] += 100
    fits = [fit_linear(p, n, v, 2.0)[0][7] for v in (values, changed)]
    np.testing.assert_allclose(*fits, atol=0.2)
    others = np.delete(np.arange(60), 7)
    slopes = np.column_stack([p[others, :2], np.ones(59)])
    known, *_ = np.linalg.lstsq(slopes, values[others], rcond=None)
    np.testing.assert_allclose(fits[0], np.append(p[7, :2], 1) @ known, atol=0.05)


def test_points_that_are_alone_are_told():
    p, n = np.array([[0.5, 0.5, 0.5], [9.5, 0.5, 0.5], [9.6, 0.5, 0.5]]), np.eye(3)[[2, 2, 2]]
    _, alone = fit_linear(p, n, np.array([[1.0], [2.0], [3.0]]), 1.0)
    np.testing.assert_array_equal(alone, [True, False, False])


def test_few_points_are_no_reason_for_fine_levels():
    """Points too far apart to tell ripples from noise, although their targets have hardly any."""

    def light(p):
        return 1 + 0.05 * np.sin(2 * np.pi * p[:, 0] / 0.12)

    many, _ = levels(light, 0.005)
    few, _ = levels(light, 0.005, COUNT // 100)
    assert np.median(many) >= 3 and (few == 0).mean() > 0.7

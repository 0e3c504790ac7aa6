"""Places where methods differ most, on arrays with a known answer."""

from __future__ import annotations

import numpy as np

from report.figures.places import (
    arriving_light,
    find_place,
    focused_light,
    typical_error,
    window_sums,
)


def test_sums_over_windows():
    score = np.random.default_rng(1).random((9, 13))
    sums = window_sums(score, 4)
    assert sums.shape == (6, 10)
    np.testing.assert_allclose(sums[2, 5], score[2:6, 5:9].sum())
    np.testing.assert_allclose(sums[5, 9], score[5:9, 9:13].sum())


def test_the_best_place_and_the_next_beside_it():
    score = np.zeros((20, 30))
    score[3:7, 21:25] = 2
    score[12:16, 5:9] = 1
    first = find_place(score, 4)
    assert first == (21, 3)
    assert find_place(score, 4, [first]) == (5, 12)
    # Without room for another square, the squares may overlap.
    assert find_place(score[:4, :4], 4, [(0, 0)]) == (0, 0)


def test_light_counts_along_surfaces_and_not_across_edges():
    height, width = 12, 16
    y, x = np.mgrid[:height, :width].astype(float)
    position, normal = np.stack([x, y, 0 * x], -1), np.zeros((height, width, 3))
    normal[..., 2] = 1
    light, valid = np.full((height, width, 3), 0.5), np.ones((height, width))
    light[:, 8:] = 2  # a shadow's edge along x = 8
    strength = focused_light(light, position, normal, valid)
    assert (strength[:, 7] == 0.75).all() and strength.sum() == 0.75 * height
    step = position.copy()
    step[:, 8:, 2] = 3  # the same light, with a step in the surface
    assert focused_light(light, step, normal, valid).sum() == 0
    corner = normal.copy()
    corner[:, 8:] = [1, 0, 0]
    assert focused_light(light, position, corner, valid).sum() == 0
    assert focused_light(light, position, normal, 0 * valid).sum() == 0


def test_one_bad_method_does_not_decide():
    errors = [np.full((4, 6), 0.1), np.full((4, 6), 0.1), np.zeros((4, 6))]
    errors[0][1, 2] = errors[1][1, 2] = 0.3
    errors[2][3, 5] = 9
    assert np.unravel_index(typical_error(errors).argmax(), (4, 6)) == (1, 2)


def test_the_light_that_arrives_has_no_texture():
    light = np.random.default_rng(2).uniform(0.5, 2, (4, 6, 3))
    texture = np.random.default_rng(3).uniform(0.1, 0.9, (4, 6, 3))
    np.testing.assert_allclose(arriving_light(light * texture, texture), light)
    assert np.isfinite(arriving_light(light, 0 * light)).all()

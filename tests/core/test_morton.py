"""Points in space order: the same points, and neighbours in the list are neighbours in space."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from gpf.core.morton import order_in_space, order_lanes_in_space
from gpf.core.structs import from_numpy


def test_the_curve_goes_through_one_octant_after_another():
    corners = np.array([[x, y, z] for x in (0, 3) for y in (0, 3) for z in (0, 3)], float)
    rng = np.random.default_rng(1)
    points = (corners[:, None] + rng.uniform(0, 1, (8, 50, 3))).reshape(-1, 3)
    shuffled = rng.permutation(points)
    order = order_in_space(shuffled, cell=0.5)
    assert sorted(order) == list(range(400))
    octant = (shuffled[order] > 2).astype(int) @ [1, 2, 4]
    assert octant.tolist() == np.repeat(np.arange(8), 50).tolist()


def test_neighbours_in_the_list_lie_close_together():
    points = np.random.default_rng(2).uniform(-2, 5, (4000, 3))
    steps = np.linalg.norm(np.diff(points[order_in_space(points, 0.2)], axis=0), axis=1)
    assert np.median(steps) < 0.15 * np.median(np.linalg.norm(np.diff(points, axis=0), axis=1))


def test_a_cube_keeps_the_order_that_it_has():
    points = np.random.default_rng(3).uniform(0, 1, (20, 3))
    assert order_in_space(points, 2.0).tolist() == list(range(20))


def test_no_points_have_an_order_too():
    assert len(order_in_space(np.zeros((0, 3)), 1.0)) == 0


def test_cells_too_small_to_be_told_apart_are_no_error():
    points = np.array([[0.0, 0, 0], [1e9, 0, 0], [2e9, 0, 0]])
    assert sorted(order_in_space(points, 1e-3)) == [0, 1, 2]


def test_lanes_have_the_same_order():
    """With 8 cubes of different points on each axis, some with negative coordinates."""
    points = np.random.default_rng(4).uniform(-4, 4, (500, 3))
    points[0] = -4  # the first cube of the plain order
    order = order_lanes_in_space(from_numpy(mi.Point3f, points + 4), 1.0).numpy()
    assert order.tolist() == order_in_space(points, 1.0).tolist()
    away = order_lanes_in_space(from_numpy(mi.Point3f, points - 1020), 1.0).numpy()
    assert away.tolist() == order.tolist()

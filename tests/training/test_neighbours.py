"""Neighbour lists hold what a query visits, each in its own row; the targets around Gaussians."""

from dataclasses import replace
from itertools import pairwise

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.core.structs import from_numpy
from gpf.field.limits import no_limits
from gpf.field.settings import FieldSettings
from gpf.training.kernels import blend_neighbours, pack
from gpf.training.neighbours import LIST_MARGIN, NeighbourLists, list_neighbours, local_targets
from tests.plain_field import (
    LOWER,
    UPPER,
    ask,
    flat_gaussians,
    make_field,
    neighbours_of,
    random_gaussians,
    random_normals,
    surface_points,
    to_device,
)
from tests.training.plane import UP, make_trainer, on_the_plane


def rows_of(lists: NeighbourLists, count: int) -> list[list[int]]:
    starts, indices = np.array(lists.starts), np.array(lists.indices)
    assert len(starts) == count + 1 and starts[0] == 0
    return [indices[a:b].tolist() for a, b in pairwise(starts)]


def plain_rows(g, settings, x, n) -> tuple[list[set[int]], np.ndarray]:
    """The lists as sets, and the supports: the ball is listed with a margin."""
    rows, supports = [], []
    for point, normal in zip(x, n, strict=True):
        indices, support = neighbours_of(g, settings, point, normal)
        if support == settings.search_radius:
            wide = settings.model_copy(update={"neighbours": "radius"})
            indices, _ = neighbours_of(g, wide, point, normal, LIST_MARGIN)
        rows.append(set(indices.tolist()))
        supports.append(support)
    return rows, np.array(supports)


@pytest.mark.parametrize("neighbours", ["both", "radius", "knn"])
@pytest.mark.parametrize("normal_test", [True, False])
def test_lists_are_those_of_the_plain_twin(neighbours, normal_test):
    rng = np.random.default_rng(8)
    g = random_gaussians(rng, 400)
    settings = FieldSettings(search_radius=0.4, k=3, neighbours=neighbours, normal_test=normal_test)
    x = rng.uniform(LOWER, UPPER, (150, 3)).astype(np.float32).astype(float)
    n = random_normals(rng, 150)
    lists = list_neighbours(make_field(g, settings), surface_points(x, n))
    rows = rows_of(lists, 150)
    expected, supports = plain_rows(g, settings, x, n)
    assert len({len(row) for row in expected}) > (0 if neighbours == "knn" else 5)
    assert [set(row) for row in rows] == expected
    assert [len(row) for row in rows] == [len(row) for row in expected]  # nothing twice
    support = np.broadcast_to(np.sqrt(np.array(lists.support2)), 150)
    np.testing.assert_allclose(support, supports, rtol=1e-5)


@pytest.mark.parametrize("neighbours", ["both", "radius", "knn"])
@pytest.mark.parametrize("blend", ["divided", "sum"])
def test_blending_a_list_is_a_query(neighbours, blend):
    rng = np.random.default_rng(9)
    g = random_gaussians(rng, 200)
    settings = FieldSettings(search_radius=0.4, k=4, neighbours=neighbours, blend=blend)
    x, n = rng.uniform(LOWER, UPPER, (100, 3)), random_normals(rng, 100)
    field = make_field(g, settings)
    points = surface_points(x, n)
    chosen = rng.permutation(100)[:60]
    value, inverse = blend_neighbours(
        points,
        list_neighbours(field, points),
        from_numpy(mi.UInt32, chosen),
        pack(field.gaussians),
        blend == "divided",
    )
    expected, reach = ask(field, x[chosen], n[chosen])
    np.testing.assert_allclose(np.array(value).T, expected, rtol=1e-4, atol=1e-6)
    if blend == "sum":
        assert (np.array(inverse) == 1).all()
    else:
        assert ((np.array(inverse) > 0) == np.isfinite(reach)).all()


def test_a_sparse_point_with_many_just_outside_its_ball_keeps_to_its_row():
    # Two within the ball and four in the margin, k = 3: three are listed, though the margin
    # holds six. The points around it are dense, and their rows come right behind.
    ring = [[1.04, 0, 0], [0, 1.05, 0], [0, -1.06, 0], [-1.07, 0, 0]]
    g = flat_gaussians([[0.5, 0, 0], [-0.5, 0, 0], *ring], np.eye(3)[[0, 1, 2, 0, 1, 2]])
    settings = FieldSettings(search_radius=1.0, k=3)
    x = np.array([[0.0, 0, 0], [0.5, 0.3, 0], [0, 0, 0.01], [0.5, -0.3, 0], [0, 0, -0.02]])
    n = np.tile(UP, (5, 1))
    for order in ([0, 1, 2, 3, 4], [1, 0, 3, 2, 4]):
        lists = list_neighbours(make_field(g, settings), surface_points(x[order], n))
        rows = rows_of(lists, 5)
        assert [set(row) for row in rows] == plain_rows(g, settings, x[order], n)[0]
        assert len(rows[order.index(0)]) == 3


def test_a_point_without_neighbours_has_an_empty_row():
    g = flat_gaussians([[0, 0.5, 0], [0.1, 0.5, 0]], np.ones((2, 3)))
    settings = FieldSettings(search_radius=0.3, neighbours="radius")
    x = np.array([[0.05, 0.5, 0], [1.5, 1.5, 0], [0.0, 0.5, 0]])
    lists = list_neighbours(make_field(g, settings), surface_points(x, np.tile(UP, (3, 1))))
    assert [sorted(row) for row in rows_of(lists, 3)] == [[0, 1], [], [0, 1]]


def test_without_any_gaussian_nearby_all_rows_are_empty():
    g = flat_gaussians([[0, 0.5, 0]], np.ones((1, 3)))
    field = make_field(g, FieldSettings(search_radius=0.3, neighbours="radius"))
    points = surface_points(np.array([[1.5, 1.5, 0], [1.6, 1.5, 0]]), np.tile(UP, (2, 1)))
    lists = list_neighbours(field, points)
    assert rows_of(lists, 2) == [[], []]
    every = dr.arange(mi.UInt32, 2)
    value, inverse = blend_neighbours(points, lists, every, pack(field.gaussians), True)
    assert (np.array(value) == 0).all() and (np.array(inverse) == 0).all()


@pytest.mark.parametrize(
    ("side", "own", "others", "height"),
    [(1, 2000, -1, 0), (-1, 2000, 1, 0), (-1, 60, 1, 0), (1, 1000, 1, 0.05)],
    ids=["above a thin wall", "below it", "few points below it", "under a surface close above"],
)
def test_targets_on_other_surfaces_do_not_count(side, own, others, height):
    """They are 1 on the Gaussians' own surface, 1000 on another, whose points are nearer or more:
    of the eight nearest to a Gaussian, most may be of the other."""
    g = make_trainer().gaussians
    x = on_the_plane(np.random.default_rng(4), 4000)
    is_own = np.arange(4000) < own
    x[~is_own, 2] += height
    normals = np.where(is_own, side, others)[:, None] * UP
    points = surface_points(x, normals, np.where(is_own, 1.0, 1000.0)[:, None] * np.ones(3))
    found = local_targets(replace(g, normals=side * g.normals), points, radius=0.3)
    np.testing.assert_allclose(found, 1, rtol=1e-5)


def test_behind_a_wall_where_no_points_are_the_values_of_the_nearest_gaussians_on_that_side_count():
    """Thousands of points before a wall, at x < 0, and a hundred far behind it: nothing is known
    of the Gaussians close behind it, but for those that lie as far behind."""
    rng = np.random.default_rng(5)
    lit = np.column_stack([-rng.uniform(0.01, 1, 4000), rng.uniform(-1, 1, 4000), np.zeros(4000)])
    behind = np.column_stack([rng.uniform(0.9, 1, 100), rng.uniform(-1, 1, 100), np.zeros(100)])
    target = np.repeat([1000.0, 1.0], [4000, 100])[:, None] * np.ones(3)
    points = surface_points(np.vstack([lit, behind]), np.tile(UP, (4100, 1)), target)
    x = np.column_stack([np.linspace(0.05, 0.95, 40), np.zeros(40), np.zeros(40)])
    limits = no_limits(40)
    limits[:, 0] = [-1, 0, 0, 0]  # -x < 0
    found = local_targets(to_device(flat_gaussians(x, np.ones((40, 3)))), points, 0.3, limits)
    np.testing.assert_allclose(found, 1, rtol=1e-5)

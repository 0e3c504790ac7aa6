"""Neighbour lists hold what a query visits: no more, no less, and each in its own row."""

from itertools import pairwise

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.core.structs import from_numpy
from gpf.field.settings import FieldSettings
from gpf.training.kernels import blend_neighbours, pack
from gpf.training.neighbours import LIST_MARGIN, NeighbourLists, list_neighbours
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
)

UP = np.array([0.0, 0.0, 1.0])


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


def test_no_neighbours_at_all():
    g = flat_gaussians([[0, 0.5, 0]], np.ones((1, 3)))
    field = make_field(g, FieldSettings(search_radius=0.3, neighbours="radius"))
    points = surface_points(np.array([[1.5, 1.5, 0], [1.6, 1.5, 0]]), np.tile(UP, (2, 1)))
    lists = list_neighbours(field, points)
    assert rows_of(lists, 2) == [[], []]
    every = dr.arange(mi.UInt32, 2)
    value, inverse = blend_neighbours(points, lists, every, pack(field.gaussians), True)
    assert (np.array(value) == 0).all() and (np.array(inverse) == 0).all()

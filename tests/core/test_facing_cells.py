"""Which way the surfaces near a place face: never a miss, and few searches in vain."""

import mitsuba as mi
import numpy as np
import pytest

from gpf.core.facing_cells import FacingCells
from gpf.core.structs import from_numpy
from tests.plain_field import random_normals

REACH = 0.2
BOX = (mi.ScalarPoint3f(-1, -1, -1), mi.ScalarPoint3f(1, 1, 1))


def ask(p: np.ndarray, n: np.ndarray, x: np.ndarray, m: np.ndarray, bounds=BOX) -> np.ndarray:
    """Whether ``may_contain`` is true for queries ``x`` with normals ``m``."""

    cells = FacingCells(from_numpy(mi.Point3f, p), from_numpy(mi.Normal3f, n), REACH, bounds)
    found = cells.may_contain(from_numpy(mi.Point3f, x), from_numpy(mi.Normal3f, m), mi.Bool(True))
    return np.asarray(found.numpy())


@pytest.mark.parametrize("size", [1.0, 300.0])  # 300: more cells than the table has entries
def test_no_neighbour_is_missed(size):
    rng = np.random.default_rng(2)
    p, x = (size * rng.uniform(-1.1, 1.1, (count, 3)) for count in (400, 3000))
    x[:400] = p + 0.5 * REACH * random_normals(rng, 400)
    n, m = random_normals(rng, 400), random_normals(rng, 3000)
    m[:400] = n + 0.4 * random_normals(rng, 400)
    m /= np.linalg.norm(m, axis=1, keepdims=True)
    bounds = tuple(mi.ScalarPoint3f(s * size) for s in (-1, 1))
    near = np.linalg.norm(x[:, None] - p, axis=2) <= REACH
    exists = (near & (m @ n.T > 0.7)).any(axis=1)
    assert exists.sum() > 300
    assert ask(p, n, x, m, bounds)[exists].all()


def test_walls_at_a_right_angle_or_behind_or_far_away_are_no_neighbours():
    up, side = np.array([0.0, 1, 0]), np.array([1.0, 0, 0])
    floor = np.stack([*np.mgrid[-1:1:9j, 0:1, -1:1:9j].reshape(3, -1)], axis=1)
    n = np.tile(up, (len(floor), 1))
    x = np.array([[0, 0.01, 0]] * 4 + [[0, 0.9, 0]])
    found = ask(floor, n, x, np.array([up, side, -up, (up + side) / 2**0.5, up]))
    assert found.tolist() == [True, False, False, True, False]


def test_inactive_queries_find_nothing():
    cells = FacingCells(mi.Point3f(0, 0, 0), mi.Normal3f(0, 0, 1), REACH, BOX)
    found = cells.may_contain(mi.Point3f(0, 0, 0), mi.Normal3f(0, 0, 1), mi.Bool([True, False]))
    assert found.numpy().tolist() == [True, False]

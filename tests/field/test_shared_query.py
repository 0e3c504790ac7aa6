"""Points that are close together share answers of the field."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy.spatial import cKDTree

from gpf.core.structs import from_numpy, to_numpy
from gpf.field.settings import FieldSettings
from gpf.field.shared_query import NEAR, SAME_SIDE, query_shared
from tests.plain_field import LOWER, UPPER, ask, make_field, random_gaussians, random_normals

RADIUS = 0.4
REACH = NEAR * RADIUS


@pytest.fixture(scope="module")
def field():
    settings = FieldSettings(search_radius=RADIUS)
    return make_field(random_gaussians(np.random.default_rng(1), 900), settings)


def shared(field, x: np.ndarray, n: np.ndarray, asks: np.ndarray, near: float = NEAR):
    p, normal = from_numpy(mi.Point3f, x), from_numpy(mi.Normal3f, n)
    value, reach = query_shared(field, p, normal, from_numpy(mi.Bool, asks), near)
    dr.eval(value, reach)
    return to_numpy(value), to_numpy(reach)


def crowd(seed: int, count: int):
    """Points in small crowds, with the normal of their crowd; some of them do not ask."""
    rng = np.random.default_rng(seed)
    middle = rng.uniform(LOWER, UPPER, (count, 3)).repeat(20, axis=0)
    x = middle + rng.uniform(-0.5, 0.5, middle.shape) * REACH
    return x, random_normals(rng, count).repeat(20, axis=0), rng.random(len(x)) < 0.7


@pytest.mark.parametrize("near", [0, NEAR])
def test_points_far_apart_have_their_own_answers(field, near):
    rng = np.random.default_rng(2)
    x = rng.uniform(LOWER, UPPER, (800, 3))
    n, asks = random_normals(rng, len(x)), rng.random(len(x)) < 0.7
    own = np.full(len(x), True)
    if near > 0:
        own = cKDTree(x).query(x, k=2)[0][:, 1] > REACH
    assert own.sum() > 0.9 * len(x)
    value, reach = shared(field, x, n, asks, near)
    theirs, far = ask(field, x, n, from_numpy(mi.Bool, asks))
    np.testing.assert_allclose(value[own], theirs[own], rtol=1e-5)
    np.testing.assert_allclose(reach[own], far[own], rtol=1e-5)
    assert (value[~asks] == 0).all() and np.isinf(reach[~asks]).all()


def test_nobody_asks(field):
    x = np.zeros((8, 3))
    value, reach = shared(field, x, np.tile([0, 0, 1.0], (8, 1)), np.full(8, False))
    assert (value == 0).all() and np.isinf(reach).all()


def test_close_points_have_the_answer_of_one_of_them(field):
    x, n, asks = crowd(3, 100)
    x, n = x[asks], n[asks]
    value, _ = shared(field, x, n, np.full(len(x), True))
    own, _ = ask(field, x, n)
    tree = cKDTree(x)
    for k, others in enumerate(tree.query_ball_point(x, REACH)):
        others = [j for j in others if n[j] @ n[k] > SAME_SIDE]
        apart = np.abs(own[others] - value[k]).max(axis=1)
        assert apart.min() <= 1e-5 * max(value[k].max(), 1e-3)
    assert len(np.unique(value, axis=0)) < 0.4 * len(x)
    assert (shared(field, x, n, np.full(len(x), True))[0] == value).all(), "other bits"


def test_points_that_face_different_sides_share_nothing(field):
    x, n, _ = crowd(4, 100)
    turned = np.cross(n, [0.3, 0.5, 0.8])
    turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    angle = 1.1 * np.arccos(SAME_SIDE)  # normals are rounded
    n[1::2] = (np.cos(angle) * n + np.sin(angle) * turned)[1::2]
    value, _ = shared(field, x, n, np.full(len(x), True))
    own, _ = ask(field, x, n)
    for side in (0, 1):
        others, found = own[side::2].reshape(100, 10, 3), value[side::2].reshape(100, 10, 3)
        apart = np.abs(others[:, :, None] - found[:, None]).max(axis=3)
        assert (apart.min(axis=1) <= 1e-5 * np.maximum(found.max(axis=2), 1e-3)).all()

"""The hand-written adjoint of the blend against finite differences in double precision."""

from itertools import pairwise

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.core.structs import from_numpy
from gpf.field.settings import FieldSettings
from gpf.training.kernels import (
    accumulate_gradients,
    pack,
    parameters,
    unpack_gradients,
    with_parameters,
    zero_gradients,
)
from gpf.training.neighbours import list_neighbours
from tests.plain_field import (
    PlainGaussians,
    make_field,
    random_gaussians,
    random_normals,
    surface_points,
    to_device,
    weights_of,
)

COUNT, POINTS = 24, 30
# Several points share Gaussians, one is chosen twice, one never, and the order is not ascending.
CHOSEN = np.array([*range(POINTS - 1, 3, -1), 7, 0, 2, 1])
NAMES = (
    *(f"mean {c}" for c in "xyz"),
    *(f"log scale {c}" for c in "abc"),
    *(f"quaternion {c}" for c in "xyzw"),
    *(f"irradiance {c}" for c in "rgb"),
)


class Problem:
    """Gaussians, points with targets, their neighbour lists, and the weights of the loss."""

    def __init__(self, blend: str, neighbours: str = "both", loss: str = "relative") -> None:
        rng = np.random.default_rng(21)
        self.g = random_gaussians(rng, COUNT, sizes=(0.15, 0.9))
        self.settings = FieldSettings(
            search_radius=0.9, k=3, neighbours=neighbours, blend=blend, normal_test=False
        )
        x = rng.uniform([-1, 0, -0.5], [2, 2, 0.7], (POINTS, 3)).astype(np.float32).astype(float)
        self.x, self.n = x, random_normals(rng, POINTS)
        self.target = rng.uniform(0, 3, (POINTS, 3)).astype(np.float32).astype(float)
        self.points = surface_points(self.x, self.n, self.target)
        self.lists = list_neighbours(make_field(self.g, self.settings), self.points)
        starts, indices = np.array(self.lists.starts), np.array(self.lists.indices)
        self.rows = [indices[a:b] for a, b in pairwise(starts)]
        support2 = np.broadcast_to(np.array(self.lists.support2), POINTS)
        self.supports = np.sqrt(support2.astype(float))
        self.divided = blend == "divided"
        self.loss_name = loss
        level = np.array([self.value(self.g, b).mean() for b in range(POINTS)])
        self.weight = 1 / (level**2 + 1) if loss == "relative" else np.ones(POINTS)

    def value(self, g: PlainGaussians, b: int) -> np.ndarray:
        """The blend at a point, with the lists held fixed, in double precision."""
        w = weights_of(g, self.rows[b], self.supports[b], self.x[b])
        value = w @ g.irradiance[self.rows[b]]
        return value / w.sum() if self.divided else value

    def errors(self, g: PlainGaussians) -> np.ndarray:
        """Squared errors of the batch, with the weights of the Gaussians that it starts from."""
        return np.array(
            [self.weight[b] * ((self.value(g, b) - self.target[b]) ** 2).sum() for b in CHOSEN]
        )

    def loss(self, g: PlainGaussians) -> float:
        """Mean squared error."""
        return float(self.errors(g).sum() / (3 * len(CHOSEN)))

    def finite_differences(self, step: float = 1e-5) -> np.ndarray:
        base = self.g.flat()
        gradient = np.zeros_like(base)
        for place in np.ndindex(base.shape):
            sides = []
            for sign in (1, -1):
                moved = base.copy()
                moved[place] += sign * step
                sides.append(self.loss(self.g.with_flat(moved)))
            gradient[place] = (sides[0] - sides[1]) / (2 * step)
        return gradient

    def adjoint(self, anisotropic: bool = True) -> tuple[np.ndarray, np.ndarray]:
        """Errors and gradients from the kernels."""
        gaussians = to_device(self.g)
        gradients = zero_gradients(COUNT)
        errors = accumulate_gradients(
            self.points,
            self.lists,
            from_numpy(mi.UInt32, CHOSEN),
            pack(gaussians),
            gradients,
            mi.Float(1 / (3 * len(CHOSEN))),
            self.divided,
            self.loss_name,
        )
        dr.eval(errors, gradients)
        unpacked = unpack_gradients(gaussians, gradients, anisotropic)
        return np.array(errors), np.array([np.array(v) for v in unpacked])


@pytest.mark.parametrize("neighbours", ["both", "radius", "knn"])
@pytest.mark.parametrize("blend", ["divided", "sum"])
@pytest.mark.parametrize("loss", ["relative", "squared"])
def test_adjoint_is_the_finite_difference_in_all_parameters(loss, blend, neighbours):
    problem = Problem(blend, neighbours, loss)
    shared = np.bincount(np.concatenate([problem.rows[b] for b in CHOSEN]), minlength=COUNT)
    assert (shared > 1).sum() > COUNT / 2
    errors, found = problem.adjoint()
    np.testing.assert_allclose(errors, problem.errors(problem.g), rtol=1e-4, atol=1e-5)
    expected = problem.finite_differences()
    for name, one, other in zip(NAMES, found, expected, strict=True):
        size = np.abs(other).max()
        assert size > 1e-4, name
        np.testing.assert_allclose(one, other, atol=3e-4 * size, err_msg=name)


def test_isotropic_gaussians_get_one_gradient_for_their_three_scales():
    problem = Problem("divided")
    _, free = problem.adjoint()
    _, tied = problem.adjoint(anisotropic=False)
    assert np.abs(np.diff(free[3:6], axis=0)).max() > 1e-3
    np.testing.assert_allclose(tied[3:6], np.tile(free[3:6].mean(axis=0), (3, 1)), rtol=1e-5)
    others = [0, 1, 2, *range(6, 13)]
    np.testing.assert_allclose(tied[others], free[others], atol=1e-5)


def test_a_point_that_meets_its_target_pulls_at_nothing():
    problem = Problem("divided")
    problem.target = np.array([problem.value(problem.g, b) for b in range(POINTS)])
    problem.points = surface_points(problem.x, problem.n, problem.target)
    errors, gradient = problem.adjoint()
    assert errors.max() < 1e-9
    assert np.abs(gradient).max() < 1e-5


def test_what_is_not_finite_is_no_gradient():
    """A broken target spoils its own error alone, which is told."""
    problem = Problem("divided")
    plain = problem.adjoint()[1]
    problem.target[CHOSEN[0]] = np.nan
    problem.points = surface_points(problem.x, problem.n, problem.target)
    errors, gradient = problem.adjoint()
    assert np.isnan(errors[0]) and np.isfinite(errors[1:]).all()
    assert np.isfinite(gradient).all() and np.abs(gradient).max() < 2 * np.abs(plain).max()


def test_parameters_are_packed_and_unpacked_in_one_order():
    g = random_gaussians(np.random.default_rng(1), 5)
    gaussians = to_device(g)
    flat = parameters(gaussians)
    np.testing.assert_array_equal(np.array([np.array(v) for v in flat]), g.flat())
    again = with_parameters(gaussians, [v + 1 for v in flat])
    np.testing.assert_allclose(
        np.array([np.array(v) for v in parameters(again)]), g.flat() + 1, rtol=1e-6
    )
    np.testing.assert_array_equal(np.array(again.normals), np.array(gaussians.normals))

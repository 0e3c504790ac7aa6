"""The field's answer has the derivatives of the blend: against finite differences of its plain twin
in double precision, and forward against backward."""

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.core.structs import from_numpy, to_numpy
from gpf.field.settings import FieldSettings
from gpf.training import differentiable_query
from gpf.training.differentiable_query import query
from gpf.training.kernels import parameters, with_parameters
from tests.plain_field import (
    LOWER,
    UPPER,
    make_field,
    plain_query,
    random_gaussians,
    random_normals,
    single,
)

COUNT, POINTS, STEP = 40, 23, 1e-5
NAMES = "means", "log_scales", "quats", "irradiance", "x"


class Problem:
    """A field, points of which every seventh does not ask, and a direction in which all moves."""

    def __init__(self, blend: str = "divided") -> None:
        rng = np.random.default_rng(5)
        self.g = random_gaussians(rng, COUNT, sizes=(0.15, 0.9))
        # The support of the k nearest would move with them.
        self.settings = FieldSettings(
            search_radius=0.9, k=3, neighbours="radius", blend=blend, normal_test=False
        )
        self.field = make_field(self.g, self.settings)
        self.x = single(rng.uniform(LOWER, UPPER, (POINTS, 3)))
        self.n = random_normals(rng, POINTS)
        self.active = np.arange(POINTS) % 7 != 3
        self.moved = rng.normal(size=(13, COUNT)), rng.normal(size=(POINTS, 3))
        self.weight = rng.normal(size=(POINTS, 3))

    def plain(self, step: float) -> np.ndarray:
        g = self.g.with_flat(self.g.flat() + step * self.moved[0])
        return plain_query(g, self.settings, self.x + step * self.moved[1], self.n)[0]

    def along(self, values: list, x: mi.Point3f) -> float:
        """The gradients of the parameters, in the direction in which they move."""
        pairs = zip(values, self.moved[0], strict=True)
        total = sum((np.array(dr.grad(value)) * moved).sum() for value, moved in pairs)
        return float(total + (to_numpy(dr.grad(x)) * self.moved[1]).sum())

    def attached(self) -> tuple[list, mi.Point3f, mi.Color3f]:
        values, x = dr.copy(parameters(self.field.gaussians)), from_numpy(mi.Point3f, self.x)
        dr.enable_grad(values, x)
        gaussians = with_parameters(self.field.gaussians, values)
        asks, n = from_numpy(mi.Bool, self.active), from_numpy(mi.Normal3f, self.n)
        return values, x, query(self.field, gaussians, x, n, asks)


@pytest.fixture(params=[differentiable_query.AT_ONCE, 8])
def at_once(request, monkeypatch):
    monkeypatch.setattr(differentiable_query, "AT_ONCE", request.param)


@pytest.mark.parametrize("blend", ["divided", "sum"])
def test_forward_is_that_of_finite_differences(blend, at_once):
    problem = Problem(blend)
    values, x, found = problem.attached()
    expected = problem.plain(0) * problem.active[:, None]
    np.testing.assert_allclose(to_numpy(found), expected, rtol=1e-4, atol=1e-5)
    dr.set_grad(values, [from_numpy(mi.Float, v) for v in problem.moved[0]])
    dr.set_grad(x, from_numpy(mi.Point3f, problem.moved[1]))
    slope = to_numpy(dr.forward_to(found))
    differences = (problem.plain(STEP) - problem.plain(-STEP)) / (2 * STEP)
    differences *= problem.active[:, None]
    assert np.linalg.norm(slope - differences) < 1e-3 * np.linalg.norm(differences)


@pytest.mark.parametrize("scale", [1.0, 1e-6, 1e8])
def test_backward_is_the_transpose_of_forward(scale, at_once):
    """For weights of any size, although the sums are of whole numbers."""
    problem = Problem()
    values, x, found = problem.attached()
    dr.set_grad(values, [from_numpy(mi.Float, v) for v in problem.moved[0]])
    dr.set_grad(x, from_numpy(mi.Point3f, problem.moved[1]))
    along = float((to_numpy(dr.forward_to(found)) * problem.weight).sum())
    values, x, found = problem.attached()
    dr.backward(dr.sum(dr.dot(found, from_numpy(mi.Color3f, scale * problem.weight))))
    back = sum(
        (np.array(dr.grad(v)) * m).sum() for v, m in zip(values, problem.moved[0], strict=True)
    )
    back += (to_numpy(dr.grad(x)) * problem.moved[1]).sum()
    assert back / scale == pytest.approx(along, rel=1e-4)


@pytest.mark.parametrize("which", range(5))
def test_each_parameter_by_itself(which):
    """An error in a small derivative could hide in the sum of all."""
    problem = Problem()
    rows = [slice(0, 3), slice(3, 6), slice(6, 10), slice(10, 13), slice(0, 0)][which]
    alone = np.zeros_like(problem.moved[0])
    alone[rows] = problem.moved[0][rows]
    problem.moved = alone, problem.moved[1] * (NAMES[which] == "x")
    values, x, found = problem.attached()
    dr.backward(dr.sum(dr.dot(found, from_numpy(mi.Color3f, problem.weight))))
    back = sum(
        (np.array(dr.grad(v)) * m).sum() for v, m in zip(values, problem.moved[0], strict=True)
    )
    back += (to_numpy(dr.grad(x)) * problem.moved[1]).sum()
    differences = (problem.plain(STEP) - problem.plain(-STEP)) / (2 * STEP)
    expected = (differences * problem.active[:, None] * problem.weight).sum()
    assert back == pytest.approx(expected, rel=1e-3)


def test_sums_over_very_many_points():
    """The value is linear in the colours c: Σ c · ∂L/∂c = L, of a few Gaussians for all points."""
    problem, count = Problem(), 300_000
    rng = np.random.default_rng(1)
    x = from_numpy(mi.Point3f, rng.uniform(LOWER, UPPER, (count, 3)))
    n, asks = dr.zeros(mi.Normal3f, count), dr.full(mi.Bool, True, count)
    g = problem.field.gaussians
    colour = mi.Color3f(g.irradiance)
    dr.enable_grad(colour)
    total = dr.sum(dr.sum(query(problem.field, replace(g, irradiance=colour), x, n, asks)))
    dr.backward(total)
    back = (to_numpy(dr.grad(colour)) * to_numpy(g.irradiance)).sum()
    assert back == pytest.approx(float(total[0]), rel=1e-3)

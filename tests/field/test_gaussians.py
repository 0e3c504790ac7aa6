"""The Gaussians' geometry against numpy, finite differences and Dr.Jit's own derivatives."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.core.structs import from_numpy
from gpf.field.gaussians import rotation_columns, whitening_adjoint, whitening_rows
from tests.plain_field import random_gaussians

COUNT = 7


@pytest.fixture
def plain():
    return random_gaussians(np.random.default_rng(5), COUNT, sizes=(0.02, 3.0))


def as_quaternion(quats: np.ndarray) -> mi.Quaternion4f:
    return from_numpy(mi.Quaternion4f, quats)


def to_array(rows) -> np.ndarray:
    """Three vectors of N lanes -> (N, 3, 3)."""
    return np.stack([np.array(row).T for row in rows], axis=1)


def test_a_quarter_turn_about_z_takes_x_to_y():
    half = float(np.sqrt(0.5))
    a, b, c = rotation_columns(mi.Quaternion4f(0, 0, half, half))
    np.testing.assert_allclose(np.array(a).ravel(), [0, 1, 0], atol=1e-6)
    np.testing.assert_allclose(np.array(b).ravel(), [-1, 0, 0], atol=1e-6)
    np.testing.assert_allclose(np.array(c).ravel(), [0, 0, 1], atol=1e-6)


def test_rows_are_those_of_numpy(plain):
    rows = to_array(
        whitening_rows(from_numpy(mi.Vector3f, plain.log_scales), as_quaternion(plain.quats))
    )
    expected = plain.rows()
    np.testing.assert_allclose(rows, expected, atol=3e-6 * np.abs(expected).max())


def test_rows_square_to_the_inverse_covariance(plain):
    rows = to_array(
        whitening_rows(from_numpy(mi.Vector3f, plain.log_scales), as_quaternion(plain.quats))
    )
    columns_of_rotation = to_array(rotation_columns(as_quaternion(plain.quats)))
    for m, r, log_s in zip(rows, columns_of_rotation, plain.log_scales, strict=True):
        covariance = r.T @ np.diag(np.exp(2 * log_s)) @ r  # r holds the columns as rows
        np.testing.assert_allclose(m.T @ m @ covariance, np.eye(3), atol=2e-2)
        assert np.linalg.det(r) == pytest.approx(1, abs=1e-5)


def finite_differences(plain, weights: np.ndarray, step: float = 1e-6) -> np.ndarray:
    """Gradients of sum(weights * rows) w.r.t. log scales and quaternions, (7, N), in double."""
    base = plain.flat()
    gradients = []
    for k in range(3, 10):
        sides = []
        for sign in (1, -1):
            moved = base.copy()
            moved[k] += sign * step
            sides.append((plain.with_flat(moved).rows() * weights).sum(axis=(1, 2)))
        gradients.append((sides[0] - sides[1]) / (2 * step))
    return np.array(gradients)


def test_adjoint_is_the_finite_difference(plain):
    weights = np.random.default_rng(6).normal(size=(COUNT, 3, 3))
    scales, quats = whitening_adjoint(
        from_numpy(mi.Vector3f, plain.log_scales),
        as_quaternion(plain.quats),
        tuple(from_numpy(mi.Vector3f, weights[:, k]) for k in range(3)),
    )
    found = np.concatenate([np.array(scales), np.array(quats)])
    expected = finite_differences(plain, weights)
    assert np.abs(expected).min(axis=1).max() > 0.01  # not a comparison of zeros
    for one, other in zip(found.T, expected.T, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-5 * np.abs(other).max())


def test_adjoint_is_the_derivative_of_dr_jit(plain):
    weights = np.random.default_rng(7).normal(size=(COUNT, 3, 3))
    grad_rows = tuple(from_numpy(mi.Vector3f, weights[:, k]) for k in range(3))
    log_scales = from_numpy(mi.Vector3f, plain.log_scales)
    parts = [from_numpy(mi.Float, c) for c in plain.quats.T]
    scales, quats = whitening_adjoint(log_scales, mi.Quaternion4f(*parts), grad_rows)

    dr.enable_grad(log_scales, parts)
    rows = whitening_rows(log_scales, mi.Quaternion4f(*parts))
    dr.backward(sum(dr.dot(row, g) for row, g in zip(rows, grad_rows, strict=True)))
    for k in range(3):
        expected = np.array(dr.grad(log_scales[k]))
        np.testing.assert_allclose(np.array(scales[k]), expected, rtol=1e-4, atol=1e-3)
    for k in range(4):
        expected = np.array(dr.grad(parts[k]))
        assert np.abs(expected).max() > 0.1
        np.testing.assert_allclose(np.array(quats[k]), expected, rtol=1e-4, atol=1e-3)


def test_the_length_of_a_quaternion_gets_no_gradient(plain):
    weights = np.random.default_rng(8).normal(size=(COUNT, 3, 3))
    _, quats = whitening_adjoint(
        from_numpy(mi.Vector3f, plain.log_scales),
        as_quaternion(plain.quats),
        tuple(from_numpy(mi.Vector3f, weights[:, k]) for k in range(3)),
    )
    gradient = np.array(quats).T
    along = np.abs((gradient * plain.quats).sum(axis=1))
    lengths = np.linalg.norm(gradient, axis=1) * np.linalg.norm(plain.quats, axis=1)
    assert (along < 1e-5 * lengths).all()

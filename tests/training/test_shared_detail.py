"""Noise is taken out of a field's colours, light is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gpf.core.structs import to_numpy
from gpf.field.field import GaussianPhotonField
from gpf.field.settings import FieldSettings
from gpf.training.half_colours import HalfColours
from gpf.training.shared_detail import keep_shared_detail
from tests.plain_field import flat_gaussians, make_field, surface_points

SIDE, STEP = 60, 0.03


@pytest.fixture(scope="module")
def places() -> np.ndarray:
    """Of Gaussians on a plane, (N, 3)."""
    x, y = np.indices((SIDE, SIDE)).reshape(2, -1) * STEP - 0.9
    return np.column_stack([x, y, 0 * x])


def light_on(places: np.ndarray) -> np.ndarray:
    """A slope of light with a bright line, one Gaussian wide, (N, 3)."""
    slope = 1 + 0.3 * places[:, 0]
    line = 6 * np.exp(-((places[:, 1] / 0.02) ** 2))
    return np.outer(slope + line, [1.0, 0.8, 0.5])


def fit(places: np.ndarray, noise: float) -> tuple[GaussianPhotonField, HalfColours]:
    """A field whose colours have the noise of two halves."""
    rng = np.random.default_rng(1)
    light = light_on(places)
    halves = [light * (1 + noise * rng.normal(size=(len(places), 1))) for _ in range(2)]
    settings = FieldSettings(search_radius=2.5 * STEP, neighbours="radius")
    mean = (halves[0] + halves[1]) / 2
    field = make_field(flat_gaussians(places, mean, size=0.7 * STEP), settings)
    up = np.tile([0.0, 0.0, 1.0], (len(places), 1))
    first, second = (surface_points(places, up, half) for half in halves)
    return field, HalfColours.fit(field, (first, second))


def colours_of(field: GaussianPhotonField) -> np.ndarray:
    return to_numpy(field.gaussians.irradiance)


def test_noise_is_taken_out_and_light_is_kept(places):
    field, fitted = fit(places, noise=0.15)
    light, before = light_on(places), colours_of(field)
    keep_shared_detail(field, fitted)
    after = colours_of(field)
    wrong = [np.abs(found / light - 1).mean(axis=1) for found in (before, after)]
    far = np.abs(places[:, 1]) > 0.25
    assert wrong[1][far].mean() < 0.35 * wrong[0][far].mean()
    assert wrong[1][~far].mean() < wrong[0][~far].mean()
    line = np.abs(places[:, 1]) < 0.01
    assert after[line].mean() == pytest.approx(before[line].mean(), rel=0.05)


def test_energy_is_kept(places):
    field, fitted = fit(places, noise=0.3)
    whole = fitted.matrix @ colours_of(field)
    keep_shared_detail(field, fitted)
    kept = fitted.matrix @ colours_of(field)
    assert kept.mean() == pytest.approx(whole.mean(), rel=3e-3)


def test_without_noise_nothing_changes(places):
    field, fitted = fit(places, noise=0)
    colours = colours_of(field)
    keep_shared_detail(field, fitted)
    np.testing.assert_allclose(colours_of(field), colours, rtol=2e-3, atol=2e-3)


def test_gaussians_that_no_point_sees_keep_their_colours(places):
    field, fitted = fit(places, noise=0.15)
    matrix = fitted.matrix.tolil()
    matrix[:, 100] = 0
    blind = replace(fitted, matrix=matrix.tocsr(), halves=fitted.halves.copy())
    blind.halves[:, 100] = 0
    colours = colours_of(field)
    keep_shared_detail(field, blind)
    np.testing.assert_allclose(colours_of(field)[100], colours[100], rtol=1e-6)


def test_a_photon_of_great_power_is_no_caustic(places):
    """Its light is kept, spread over the surface around, but for a caustic both halves need it."""
    field, fitted = fit(places, noise=0)
    at = np.array([[0.3, 0, 0], [-0.3, 0.4, 0]])
    lit, photon = np.linalg.norm(places - at[:, None], axis=2) < 1.2 * STEP
    caustics = np.zeros((2, len(places), 3), np.float32)
    caustics[:, lit], caustics[1, photon] = 10, 20
    keep_shared_detail(field, replace(fitted, caustics=caustics))
    found = field.caustics * colours_of(field) / fitted.unit
    assert found[lit].mean() > 5
    assert found[photon].max() < 3  # of 10
    each = fitted.matrix.sum(axis=0) @ found
    whole = fitted.matrix.sum(axis=0) @ caustics.mean(axis=0)
    np.testing.assert_allclose(each, whole, rtol=0.02)

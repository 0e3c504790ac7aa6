"""The kernel estimate against a plain sum."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.core.structs import Photons, from_numpy
from gpf.core.surface_tags import UNLIMITED
from gpf.photons.density import PhotonDensity

STEP = 2.0**-8
BOX = ((-1, -1, -1), (1, 1, 1))


def to_normals(array: np.ndarray) -> mi.Normal3f:
    return from_numpy(mi.Normal3f, array)


def to_points(array: np.ndarray) -> mi.Point3f:
    return from_numpy(mi.Point3f, array)


# Normals that are 0°, 30°, 60°, 90° … apart: none near the limit of 45°.
ANGLES = np.radians([0, 30, 60, 90, 180, 270])
NORMALS = np.stack([np.zeros(6), np.sin(ANGLES), np.cos(ANGLES)], axis=1)


def make_photons(count: int, seed: int) -> Photons:
    """Photons on a coarse lattice, so that distances are exact and many tie with the radius."""
    rng = np.random.default_rng(seed)
    return Photons(
        p=to_points(lattice(rng, count)),
        n=to_normals(NORMALS[rng.integers(0, 6, count)]),
        power=from_numpy(mi.Color3f, rng.uniform(0, 1, (count, 3)) ** 4),
        depth=from_numpy(mi.UInt32, rng.choice([0, 1, 2, 3, 7, 300], count)),
    )


def lattice(rng: np.random.Generator, count: int) -> np.ndarray:
    return rng.integers(-32, 33, (count, 3)) * (4 * STEP) * [1, 0.5, 0.25]


def rows(*values: object) -> list[np.ndarray]:
    return [np.asarray(v.numpy(), dtype=np.float64).T for v in values]  # type: ignore[attr-defined]


def sum_by_hand(x, n, budget, photons, radius):  # type: ignore[no-untyped-def]
    """1 / (π r²) Σ Φ_i, one pair at a time in double precision."""
    p, pn, power, depth = rows(photons.p, photons.n, photons.power, photons.depth)
    d = x[:, None] - p[None]
    near = (d**2).sum(2) <= radius**2
    near &= n @ pn.T > 0.7
    near &= np.abs((d * n[:, None]).sum(2)) <= 0.5 * radius + 1e-9  # many tie
    near &= depth[None] <= budget[:, None]
    return near.astype(np.float64) @ power / (np.pi * radius**2), near


def test_irradiance_is_the_plain_sum():
    """At any points, and at the photons themselves, which count."""
    rng = np.random.default_rng(5)
    photons = make_photons(6000, seed=6)
    p, pn = rows(photons.p, photons.n)
    x = np.concatenate([lattice(rng, 900), p[:900]])
    n = np.concatenate([NORMALS[rng.integers(0, 6, 900)], pn[:900]])
    active = rng.random(1800) < 0.8
    budget = rng.choice([0, 1, 2, 5, 126], 1800)
    radius = 20 * STEP
    found = PhotonDensity(photons, radius, BOX).irradiance(
        to_points(x),
        to_normals(n),
        from_numpy(mi.Bool, active),
        budget=from_numpy(mi.UInt32, budget),
    )
    expected, near = sum_by_hand(x, n, budget, photons, radius)
    expected[~active] = 0
    assert 3 < near[active].sum(1).mean() < 200 and near[900:, :900].diagonal().any()
    np.testing.assert_allclose(found.numpy().T, expected, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("threads", [1, 3])
def test_the_number_of_threads_changes_no_bit(threads):
    rng = np.random.default_rng(7)
    x, n = to_points(lattice(rng, 300)), to_normals(NORMALS[rng.integers(0, 6, 300)])
    photons = make_photons(20_000, seed=8)
    expected = PhotonDensity(photons, 30 * STEP, BOX).irradiance(x, n).numpy()
    before = dr.thread_count()
    dr.set_thread_count(threads)
    try:
        found = PhotonDensity(photons, 30 * STEP, BOX).irradiance(x, n).numpy()
    finally:
        dr.set_thread_count(before)
    np.testing.assert_array_equal(found, expected)
    assert (expected > 0).mean() > 0.9


def power_at(x, photons_at, power, depth=0, radius=0.1, **options):  # type: ignore[no-untyped-def]
    """The power within the radius of points of a floor, W, (3, N), from photons there."""
    count = len(photons_at)
    photons = Photons(
        mi.Point3f(photons_at, 0, 0),
        mi.Normal3f(0, 0, 1),
        mi.Color3f(*power),
        mi.UInt32(depth) + dr.zeros(mi.UInt32, count),
    )
    density = PhotonDensity(photons, radius, BOX)
    e = density.irradiance(mi.Point3f(x, 0, 0), mi.Normal3f(0, 0, 1), **options)
    return e.numpy() * np.pi * radius**2


@pytest.mark.parametrize(
    ("places", "power", "expected"),
    [
        # A lamp of a millionth of the other's power, where the other does not shine.
        (
            [0, 0.5, 0.5],
            ([3.0, 2e-6, 1e-6], [2.0, 0, 3e-6], [0.0, 0, 0]),
            [[3, 3e-6], [2, 3e-6], [0, 0]],
        ),
        # Environment maps and lamps with negative channels are scenes like others.
        (
            [0, 0, 0],
            ([1.0, -0.25, 0.5], [0.5, -2.0, 0], [-1.0, 0, 0]),
            [[1.25, 0], [-1.5, 0], [-1, 0]],
        ),
    ],
    ids=["dim beside bright", "below zero"],
)
def test_powers_of_any_size_and_sign_add_up(places, power, expected):
    np.testing.assert_allclose(power_at([0.0, 0.5], places, power), expected, rtol=1e-5)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_powers_that_are_no_numbers_do_not_hide(value):
    """Whoever checks the image finds them, at the points around the photon alone."""
    power = mi.Float(1), mi.Float([1, 2, value, 3, 4]), mi.Float(0)
    found = power_at([0, 0.5], [0, 0.1, 0.5, 0.6, 0.5], power, radius=0.2)
    assert np.isfinite(found).tolist() == [[True, True], [True, False], [True, True]]


@pytest.mark.parametrize("count", [0, 2])
def test_without_light_irradiance_is_zero(count):
    density = PhotonDensity(dr.zeros(Photons, count), 0.1, BOX)
    e = density.irradiance(to_points(np.zeros((5, 3))), mi.Normal3f(0, 0, 1))
    np.testing.assert_array_equal(e.numpy(), np.zeros((3, 5)))


@pytest.mark.parametrize(("budget", "counts"), [(UNLIMITED, 3), (126, 0)])
def test_a_photon_deeper_than_any_budget_counts_where_there_is_none(budget, counts):
    found = power_at([0, 0.5], [0, 0, 0], (1, 2, 3), [255, 256, 100_000], budget=budget)
    expected = [[counts, 0], [2 * counts, 0], [3 * counts, 0]]
    np.testing.assert_allclose(found, expected, rtol=1e-6)


@pytest.mark.parametrize(("smooth", "spread"), [(False, 1), (True, 4 / 3)])
def test_the_kernel_is_normalised(smooth, spread):
    """``spread``: the mean of the squared kernel over its disc.

    Photons of 1 W/m² on a plane give E = 1 W/m² away from its edges, for any radius.
    """
    rng = np.random.default_rng(11)
    side = 600  # one photon in each of 600² squares: less noise than photons anywhere
    count = side * side
    corner = np.stack(np.meshgrid(np.arange(side), np.arange(side)), axis=-1).reshape(count, 2)
    p = np.zeros((count, 3))
    p[:, :2] = (corner + rng.random((count, 2))) * 2 / side - 1
    photons = Photons(
        to_points(p), mi.Normal3f(0, 0, 1), mi.Color3f(4 / count), dr.zeros(mi.UInt32, count)
    )
    x = np.concatenate([rng.uniform(-0.7, 0.7, (2000, 2)), np.zeros((2000, 1))], axis=1)
    for radius in (0.03, 0.1, 0.3):
        density = PhotonDensity(photons, radius, BOX, smooth)
        e = density.irradiance(to_points(x), mi.Normal3f(0, 0, 1)).numpy()[0]
        noise = math.sqrt(spread / (count / 4 * math.pi * radius**2))
        assert e.mean() == pytest.approx(1, abs=1e-3)
        assert e.std() < noise

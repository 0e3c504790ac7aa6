"""The radius schedule by hand, the tags bit by bit, the kernel estimate against a plain sum."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.core.spatial_hash import Record, SpatialHash
from gpf.core.structs import Photons, from_numpy
from gpf.core.surface_tags import UNLIMITED, pack_tag, same_surface, unpack_depth, unpack_normal
from gpf.sppm.density import PhotonDensity, radius_at

STEP = 2.0**-8
BOX = ((-1, -1, -1), (1, 1, 1))


def next_radius(radius: float, t: int, alpha: float) -> float:
    """The recurrence of Knaus and Zwicker 2011."""
    return radius * math.sqrt((t + alpha) / (t + 1))


def test_three_passes_by_hand():
    """α = 0.7: r₂² = r₁² 1.7/2 and r₃² = r₂² 2.7/3."""
    assert next_radius(0.02, 1, 0.7) == pytest.approx(0.02 * math.sqrt(0.85), rel=1e-12)
    second = 0.02 * 0.92195444573  # √0.85
    third = second * 0.94868329805  # √0.9
    assert radius_at(1, 0.02, 0.7) == pytest.approx(0.02, rel=1e-9)
    assert radius_at(2, 0.02, 0.7) == pytest.approx(second, rel=1e-9)
    assert radius_at(3, 0.02, 0.7) == pytest.approx(third, rel=1e-9)
    assert radius_at(3, 0.02, 0.7) == pytest.approx(0.0174928557, rel=1e-8)


@pytest.mark.parametrize("alpha", [0.05, 0.5, 0.7, 0.95])
def test_closed_form_follows_the_recurrence(alpha):
    radius = 0.3
    for t in range(1, 1001):
        assert radius_at(t, 0.3, alpha) == pytest.approx(radius, rel=1e-9), t
        radius = next_radius(radius, t, alpha)


def test_radii_shrink_without_end_but_slowly():
    """r_t ∝ t^((α-1)/2): bias goes, and the noise of the mean goes as well."""
    ratio = radius_at(4_000_000, 1, 0.7) / radius_at(1_000_000, 1, 0.7)
    assert ratio == pytest.approx(4 ** ((0.7 - 1) / 2), rel=1e-5)


def unit_vectors(count: int, seed: int = 1) -> np.ndarray:
    v = np.random.default_rng(seed).normal(size=(count, 3))
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    v[:6] = np.concatenate([np.eye(3), -np.eye(3)])
    return v


def to_normals(array: np.ndarray) -> mi.Normal3f:
    return from_numpy(mi.Normal3f, array)


def to_points(array: np.ndarray) -> mi.Point3f:
    return from_numpy(mi.Point3f, array)


def test_tags_hold_normal_and_depth():
    n = unit_vectors(5120)
    depth = (np.arange(5120) % 256).astype(np.uint32)
    tag = pack_tag(to_normals(n), from_numpy(mi.UInt32, depth))
    np.testing.assert_allclose(unpack_normal(tag).numpy().T, n, atol=4e-3)
    np.testing.assert_array_equal(np.array(unpack_depth(tag)), depth)


def test_depths_saturate():
    tag = pack_tag(mi.Normal3f(0, 0, 1), mi.UInt32([0, 254, 255, 256, 0xFFFFFFFF]))
    assert np.array(unpack_depth(tag)).tolist() == [0, 254, 255, 255, 255]


def test_tags_survive_the_hash():
    """Read as a float, many tags are no numbers; their bits have to arrive all the same."""
    n = unit_vectors(4096, seed=2)
    depth = np.random.default_rng(3).integers(0, 256, 4096).astype(np.uint32)
    tag = pack_tag(to_normals(n), from_numpy(mi.UInt32, depth))
    assert np.isnan(tag.numpy()).any()
    grid = SpatialHash(to_points(n), cell=0.1, bounds=BOX, tag=tag)
    record = grid.record(dr.arange(mi.UInt32, 4096), mi.Bool(True))
    order = grid.order.numpy()
    np.testing.assert_array_equal(np.array(unpack_depth(record.tag)), depth[order])
    np.testing.assert_allclose(unpack_normal(record.tag).numpy().T, n[order], atol=4e-3)


def same(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether a record with normal ``a`` and a photon with normal ``b`` lie on one surface."""
    record = Record(mi.Point3f(0), pack_tag(mi.Normal3f(a.tolist())), mi.Color3f(0))
    return bool(same_surface(record, mi.Point3f(0), mi.Normal3f(b.tolist()), mi.Float(1))[0])


@pytest.mark.parametrize(("degrees", "one"), [(0, True), (30, True), (43, True), (47, False)])
def test_surfaces_that_bend_by_less_than_45_degrees_are_one(degrees, one):
    a = math.radians(degrees)
    for axes in ((0, 1), (1, 2), (2, 0)):
        other = np.zeros(3)
        other[axes[0]], other[axes[1]] = math.cos(a), math.sin(a)
        assert same(np.eye(3)[axes[0]], other) is one
        assert same(-other, -np.eye(3)[axes[0]]) is one


def test_other_sides_and_corners_are_other_surfaces():
    for n in unit_vectors(40, seed=4):
        across = np.cross(n, [0.3, 0.5, 0.81])
        across /= np.linalg.norm(across)
        assert same(n, n)
        assert not same(n, -n)
        assert not same(n, across)
        assert not same(n, -across)


@pytest.mark.parametrize(
    ("aside", "above", "one"),
    [(0, 0.49, True), (0, 0.51, False), (0.8, -0.49, True), (0.8, -0.51, False), (4, 1.9, True)],
)
def test_inside_and_outside_of_a_thin_tube_are_two_surfaces(aside, above, one):
    """Where the normals agree: more than half a radius above one another, or too steep a way."""
    n = np.array([2, 3, 6]) / 7
    across = np.array([3, -2, 0]) / math.sqrt(13)
    p = np.array([0.1, 0.2, 0.3])
    place = p + aside * across + above * n
    tag = pack_tag(mi.Normal3f(n.tolist()))
    record = Record(mi.Point3f(place.tolist()), tag, mi.Color3f(0))
    p, n = mi.Point3f(p.tolist()), mi.Normal3f(n.tolist())
    radius2 = dr.maximum(1, dr.squared_norm(record.p - p))
    assert bool(same_surface(record, p, n, radius2)[0]) is one


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
    rng = np.random.default_rng(5)
    photons = make_photons(6000, seed=6)
    x, n = lattice(rng, 900), NORMALS[rng.integers(0, 6, 900)]
    active = rng.random(900) < 0.8
    budget = rng.choice([0, 1, 2, 5, 126], 900)
    radius = 20 * STEP
    found = PhotonDensity(photons, radius, BOX).irradiance(
        to_points(x),
        to_normals(n),
        from_numpy(mi.Bool, active),
        budget=from_numpy(mi.UInt32, budget),
    )
    expected, near = sum_by_hand(x, n, budget, photons, radius)
    expected[~active] = 0
    assert 3 < near[active].sum(1).mean() < 200
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


def test_dim_photons_beside_bright_ones_count():
    """A lamp of a millionth of the other's power, where the other does not shine."""
    photons = Photons(
        mi.Point3f([0, 0.5, 0.5], 0, 0),
        mi.Normal3f(0, 0, 1),
        mi.Color3f([3.0, 2e-6, 1e-6], [2.0, 0, 3e-6], 0),
        dr.zeros(mi.UInt32, 3),
    )
    density = PhotonDensity(photons, 0.1, BOX)
    e = density.irradiance(mi.Point3f([0, 0.5], 0, 0), mi.Normal3f(0, 0, 1))
    power = e.numpy().T * np.pi * 0.1**2
    np.testing.assert_allclose(power, [[3, 2, 0], [3e-6, 3e-6, 0]], rtol=1e-5)


def test_powers_below_zero_take_away():
    """Environment maps and lamps with negative channels are scenes like others."""
    photons = Photons(
        mi.Point3f([0, 0, 0], 0, 0),
        mi.Normal3f(0, 0, 1),
        mi.Color3f([1.0, -0.25, 0.5], [0.5, -2.0, 0], [-1.0, 0, 0]),
        dr.zeros(mi.UInt32, 3),
    )
    e = PhotonDensity(photons, 0.1, BOX).irradiance(
        mi.Point3f([0.0, 0.5], 0, 0), mi.Normal3f(0, 0, 1)
    )
    power = e.numpy().T * np.pi * 0.1**2
    np.testing.assert_allclose(power, [[1.25, -1.5, -1], [0, 0, 0]], rtol=1e-6)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_powers_that_are_no_numbers_do_not_hide(value):
    """Whoever checks the image finds them, at the points around the photon alone."""
    photons = dr.zeros(Photons, 5)
    photons.p = mi.Point3f([0, 0.1, 0.5, 0.6, 0.5], 0, 0)
    photons.n = mi.Normal3f(0, 0, 1)
    photons.power = mi.Color3f(1, mi.Float([1, 2, value, 3, 4]), 0)
    density = PhotonDensity(photons, 0.2, BOX)
    e = density.irradiance(mi.Point3f([0, 0.5], 0, 0), mi.Normal3f(0, 0, 1)).numpy()
    assert np.isfinite(e).tolist() == [[True, True], [True, False], [True, True]]


@pytest.mark.parametrize("count", [0, 2])
def test_in_the_dark(count):
    density = PhotonDensity(dr.zeros(Photons, count), 0.1, BOX)
    e = density.irradiance(to_points(np.zeros((5, 3))), mi.Normal3f(0, 0, 1))
    np.testing.assert_array_equal(e.numpy(), np.zeros((3, 5)))


def test_a_photon_deeper_than_any_budget_counts_where_there_is_none():
    photons = Photons(
        mi.Point3f([0, 0, 0], 0, 0),
        mi.Normal3f(0, 0, 1),
        mi.Color3f(1, 2, 3),
        mi.UInt32([255, 256, 100_000]),
    )
    for budget, expected in ((UNLIMITED, 3), (126, 0)):
        e = PhotonDensity(photons, 0.25, BOX).irradiance(
            mi.Point3f([0, 0.5], 0, 0), mi.Normal3f(0, 0, 1), budget=budget
        )
        power = e.numpy() * np.pi * 0.25**2
        np.testing.assert_allclose(power[:, 0], [expected, 2 * expected, 3 * expected], rtol=1e-6)
        np.testing.assert_array_equal(power[:, 1], 0)


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


def test_at_the_photons_themselves_it_is_positive():
    """A photon counts itself."""
    photons = make_photons(3000, seed=12)
    photons.depth = dr.minimum(photons.depth, UNLIMITED)
    p, n = rows(photons.p, photons.n)
    expected, near = sum_by_hand(p, n, np.full(3000, UNLIMITED), photons, 20 * STEP)
    assert near.diagonal().all() and near.sum(1).mean() > 3
    e = PhotonDensity(photons, 20 * STEP, BOX).irradiance(photons.p, photons.n).numpy().T
    np.testing.assert_allclose(e, expected, rtol=1e-5, atol=1e-5)
    assert (e > 0).all()

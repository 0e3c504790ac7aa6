"""The radius schedule by hand, the tags bit by bit, the kernel estimate against a plain sum."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf import density
from gpf.density import (
    UNLIMITED,
    IrradianceGatherer,
    estimate_irradiance,
    next_radius,
    pack_tag,
    radius_at,
    same_surface,
    takes_depth,
    unpack_normal,
)
from gpf.spatial_hash import SpatialHash
from gpf.structs import Photons

STEP = 2.0**-8
BOX = ((-1, -1, -1), (1, 1, 1))


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
    return mi.Normal3f(np.ascontiguousarray(array.T, dtype=np.float32))


def to_points(array: np.ndarray) -> mi.Point3f:
    return mi.Point3f(np.ascontiguousarray(array.T, dtype=np.float32))


def depths_taken(tag: mi.Float, depths: list[int]) -> np.ndarray:
    """Which of the depths count at the points, (N, len(depths))."""
    return np.stack([np.array(takes_depth(tag, mi.UInt32(d))) for d in depths], axis=1)


@pytest.mark.parametrize("lit", [False, True])
def test_tags_hold_normal_and_budget(lit):
    n = unit_vectors(5120)
    budget = np.arange(5120) % 128
    tag = pack_tag(to_normals(n), mi.UInt32(budget.astype(np.uint32)), mi.Bool(lit))
    np.testing.assert_allclose(unpack_normal(tag).numpy().T, n, atol=4e-3)
    depths = np.array([0, 1, 2, 50, 126, 127, 1000])
    expected = (depths <= budget[:, None]) | (budget[:, None] == UNLIMITED)
    expected[:, 0] &= not lit
    np.testing.assert_array_equal(depths_taken(tag, depths.tolist()), expected)


def test_budgets_saturate():
    tag = pack_tag(mi.Normal3f(0, 0, 1), mi.UInt32([0, 126, 127, 128, 0xFFFFFFFF]))
    assert depths_taken(tag, [0, 1, 127, 5000]).tolist() == [
        [True, False, False, False],
        [True, True, False, False],
        *[[True] * 4] * 3,
    ]


def test_tags_survive_the_hash():
    """Read as a float, many tags are no numbers; their bits have to arrive all the same."""
    n = unit_vectors(4096, seed=2)
    rng = np.random.default_rng(3)
    budget, lit = rng.integers(0, 128, 4096).astype(np.uint32), mi.Bool(rng.random(4096) < 0.5)
    tag = pack_tag(to_normals(n), mi.UInt32(budget), lit)
    assert np.isnan(tag.numpy()).any()
    grid = SpatialHash(to_points(n), cell=0.1, bounds=BOX, tag=tag)
    record = dr.gather(mi.Vector4f, grid.records, grid.slot)
    depths = [0, 1, 30, 100, 126, 127]
    np.testing.assert_array_equal(depths_taken(record.w, depths), depths_taken(tag, depths))
    np.testing.assert_allclose(unpack_normal(record.w).numpy().T, n, atol=4e-3)


def same(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether a record with normal ``a`` and a photon with normal ``b`` lie on one surface."""
    record = mi.Vector4f(0, 0, 0, pack_tag(mi.Normal3f(a.tolist())))
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
    record = mi.Vector4f(*place.tolist(), pack_tag(mi.Normal3f(n.tolist())))
    p, n = mi.Point3f(p.tolist()), mi.Normal3f(n.tolist())
    assert bool(same_surface(record, p, n, mi.Float(1))[0]) is one


# Normals that are 0°, 30°, 60°, 90° … apart: none near the limit of 45°.
ANGLES = np.radians([0, 30, 60, 90, 180, 270])
NORMALS = np.stack([np.zeros(6), np.sin(ANGLES), np.cos(ANGLES)], axis=1)


def make_photons(count: int, seed: int) -> Photons:
    """Photons on a coarse lattice, so that distances are exact and many tie with the radius."""
    rng = np.random.default_rng(seed)
    return Photons(
        p=to_points(lattice(rng, count)),
        n=to_normals(NORMALS[rng.integers(0, 6, count)]),
        power=mi.Color3f(rng.uniform(0, 1, (3, count)).astype(np.float32) ** 4),
        depth=mi.UInt32(rng.choice([0, 1, 2, 3, 7, 300], count).astype(np.uint32)),
    )


def lattice(rng: np.random.Generator, count: int) -> np.ndarray:
    return rng.integers(-32, 33, (count, 3)) * (4 * STEP) * [1, 0.5, 0.25]


def rows(*values: object) -> list[np.ndarray]:
    return [np.asarray(v.numpy(), dtype=np.float64).T for v in values]  # type: ignore[attr-defined]


def sum_by_hand(x, n, budget, photons, radius, active=None, planes="photons"):  # type: ignore[no-untyped-def]
    """1 / (π r²) Σ Φ_i, one pair at a time in double precision.

    ``planes`` says to whose surface a pair has to be near.
    """
    p, pn, power, depth = rows(photons.p, photons.n, photons.power, photons.depth)
    d = x[:, None] - p[None]
    near = (d**2).sum(2) <= radius**2
    near &= n @ pn.T > 0.7
    normals = pn[None] if planes == "photons" else n[:, None]
    near &= np.abs((d * normals).sum(2)) <= 0.5 * radius + 1e-9  # many tie
    near &= (depth[None] <= budget[:, None]) | (budget[:, None] == UNLIMITED)
    if active is not None:
        near &= active[None]
    return near.astype(np.float64) @ power / (np.pi * radius**2), near


def test_gathered_irradiance_is_the_plain_sum():
    rng = np.random.default_rng(5)
    photons = make_photons(6000, seed=6)
    x, n = lattice(rng, 900), NORMALS[rng.integers(0, 6, 900)]
    valid = rng.random(900) < 0.8
    budget = rng.choice([0, 1, 2, 5, 126, UNLIMITED], 900)
    active = rng.random(6000) < 0.9
    radius = 20 * STEP
    gatherer = IrradianceGatherer(
        to_points(x),
        to_normals(n),
        mi.Bool(valid),
        radius=radius,
        bounds=BOX,
        budget=mi.UInt32(budget.astype(np.uint32)),
    )
    gatherer.deposit(photons, mi.Bool(active))
    expected, near = sum_by_hand(x, n, budget, photons, radius, active)
    expected[~valid] = 0
    assert 3 < near[valid].sum(1).mean() < 200
    np.testing.assert_allclose(gatherer.irradiance().numpy().T, expected, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("count", [300, 20_000, 50_000])
def test_crowds_are_walked_in_finer_cells_to_the_same_sums(count, monkeypatch):
    rng = np.random.default_rng(6)
    x, n = lattice(rng, count), NORMALS[rng.integers(0, 6, count)]
    photons, radius = make_photons(1000, seed=4), 20 * STEP
    sums, cells = [], []
    build = density.SpatialHash

    def spy(*arguments, cell, **options):
        cells.append(cell)
        return build(*arguments, cell=cell, **options)

    monkeypatch.setattr(density, "SpatialHash", spy)
    for wide in (False, True):
        if wide:
            monkeypatch.setattr(density, "_cell_size", lambda *_: 2.02 * radius)
        gatherer = IrradianceGatherer(
            to_points(x), to_normals(n), mi.Bool(True), radius=radius, bounds=BOX
        )
        gatherer.deposit(photons, mi.Bool(True))
        sums.append(gatherer.irradiance().numpy())
    np.testing.assert_array_equal(*sums)
    assert sums[0].mean() > 0.1
    factor = {300: 2.02, 20_000: 1.01, 50_000: 0.68}[count]
    assert cells == pytest.approx([factor * radius, 2.02 * radius])


def test_deposits_add_up():
    """A photon walk deposits once per bounce."""
    rng = np.random.default_rng(7)
    x, n = lattice(rng, 300), NORMALS[rng.integers(0, 6, 300)]
    radius = 30 * STEP
    gatherer = IrradianceGatherer(
        to_points(x), to_normals(n), mi.Bool(True), radius=radius, bounds=BOX
    )
    np.testing.assert_array_equal(gatherer.irradiance().numpy(), 0)
    expected = np.zeros((300, 3))
    for seed in (8, 9, 10):
        photons = make_photons(2000, seed)
        gatherer.deposit(photons, mi.Bool(True))
        expected += sum_by_hand(x, n, np.full(300, UNLIMITED), photons, radius)[0]
    np.testing.assert_allclose(gatherer.irradiance().numpy().T, expected, rtol=1e-5, atol=1e-5)


def test_a_photon_deeper_than_any_budget_counts_where_there_is_none():
    photons = Photons(
        mi.Point3f(0), mi.Normal3f(0, 0, 1), mi.Color3f(1, 2, 3), mi.UInt32([255, 256, 100_000])
    )
    for budget, expected in ((UNLIMITED, 3), (126, 0)):
        gatherer = IrradianceGatherer(
            mi.Point3f([0, 0.5], 0, 0),
            mi.Normal3f(0, 0, 1),
            mi.Bool(True),
            radius=0.25,
            bounds=BOX,
            budget=budget,
        )
        gatherer.deposit(photons, mi.Bool(True))
        e = gatherer.irradiance().numpy() * np.pi * 0.25**2
        np.testing.assert_allclose(e[:, 0], [expected, 2 * expected, 3 * expected], rtol=1e-6)
        np.testing.assert_array_equal(e[:, 1], 0)


def test_the_kernel_is_normalised():
    """Photons of 1 W/m² on a plane give E = 1 W/m² away from its edges, for any radius."""
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
        gatherer = IrradianceGatherer(
            to_points(x), mi.Normal3f(0, 0, 1), mi.Bool(True), radius=radius, bounds=BOX
        )
        gatherer.deposit(photons, mi.Bool(True))
        e = gatherer.irradiance().numpy()[0]
        noise = 1 / math.sqrt(count / 4 * math.pi * radius**2)
        assert e.mean() == pytest.approx(1, abs=1e-3)
        assert e.std() < noise


def test_estimate_at_the_photons_is_the_plain_sum():
    photons = make_photons(3000, seed=12)
    radius = 20 * STEP
    p, n = rows(photons.p, photons.n)
    expected, near = sum_by_hand(p, n, np.full(3000, UNLIMITED), photons, radius, planes="points")
    assert near.diagonal().all() and near.sum(1).mean() > 3
    e = estimate_irradiance(photons, radius, BOX).numpy().T
    np.testing.assert_allclose(e, expected, rtol=1e-5, atol=1e-5)
    assert (e > 0).all()

"""Photons -> Gaussians: how many, where, how bright, and within which radius they are found."""

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.core.structs import Photons, from_numpy
from stages.config.training import InitialFieldSettings
from stages.training.photon_gaussians import initialize_gaussians, propose_search_radius

# A sheet of 3 by 2 at height 0.25, in a box that is larger.
BOUNDS = (mi.ScalarPoint3f(-0.5, -0.25, 0), mi.ScalarPoint3f(3.5, 2.25, 1))
SIZE = np.array([3.0, 2.0])
POWER = np.array([0.5, 0.25, 2.0]) / 1000


def sheet(count: int, seed: int = 0) -> Photons:
    """Photons spread evenly over the sheet, POWER each, from above."""
    x = np.random.default_rng(seed).uniform(0, SIZE, (count, 2))
    return Photons(
        p=from_numpy(mi.Point3f, np.column_stack([x, np.full(count, 0.25)])),
        n=mi.Normal3f(dr.zeros(mi.Float, count), 0, 1),
        power=from_numpy(mi.Color3f, np.tile(POWER, (count, 1))),
        depth=dr.zeros(mi.UInt32, count),
    )


def make_settings(**changes: object) -> InitialFieldSettings:
    numbers = {"gaussians": 100, "initial_scale": 0.01, "search_radius": 0.02}
    return InitialFieldSettings(**{"initial_colour": "density"} | numbers | changes)


def test_each_gaussian_sits_on_a_photon_of_its_own():
    photons = sheet(500)
    settings = make_settings(gaussians=120, initial_scale=0.03, initial_colour="flux")
    g = initialize_gaussians(photons, settings, BOUNDS, seed=1)
    assert dr.width(g.means) == dr.width(g.normals) == dr.width(g.quats) == 120
    known = {tuple(row) for row in np.array(photons.p).T}
    rows = [tuple(row) for row in np.array(g.means).T]
    assert set(rows) <= known and len(set(rows)) == 120
    np.testing.assert_allclose(np.array(g.log_scales), np.log(0.03), rtol=1e-6)
    np.testing.assert_array_equal(np.array(g.normals), np.array(photons.n)[:, :120])
    np.testing.assert_allclose(np.array(g.irradiance).T, np.tile(POWER, (120, 1)), rtol=1e-6)


def test_the_colour_stays_with_its_photon():
    photons = sheet(300)
    photons.power = mi.Color3f(photons.p.x, photons.p.y, 1)
    g = initialize_gaussians(
        photons, make_settings(gaussians=50, initial_colour="flux"), BOUNDS, seed=1
    )
    np.testing.assert_array_equal(np.array(g.irradiance)[:2], np.array(g.means)[:2])


def test_fewer_photons_than_gaussians_use_them_all():
    photons = sheet(37)
    g = initialize_gaussians(photons, make_settings(gaussians=100), BOUNDS, seed=1)
    assert dr.width(g.means) == 37
    np.testing.assert_array_equal(np.array(g.means), np.array(photons.p))


def test_density_is_the_irradiance_of_the_sheet():
    count = 4000
    settings = make_settings(gaussians=count, search_radius=0.2)
    g = initialize_gaussians(sheet(count), settings, BOUNDS, seed=1)
    x, y, _ = np.array(g.means)
    inner = (np.abs(x - 1.5) < 1.3) & (np.abs(y - 1) < 0.8)
    expected = POWER * count / SIZE.prod()
    found = np.array(g.irradiance).T[inner]
    # About 84 photons in each disc: 11% noise in one, far less in the mean of all.
    np.testing.assert_allclose(found.mean(axis=0), expected, rtol=0.04)
    np.testing.assert_allclose(found, np.tile(expected, (len(found), 1)), rtol=0.6)
    corner = (x < 0.05) & (y < 0.05)
    assert corner.any()
    assert (np.array(g.irradiance).T[corner] < 0.5 * expected).all()  # a quarter of a disc


def test_random_means_fill_the_box():
    settings = make_settings(gaussians=2000, initialization="random", initial_colour="flux")
    g = initialize_gaussians(sheet(3000), settings, BOUNDS, seed=1)
    means = np.array(g.means).T
    lower, upper = np.array([-0.5, -0.25, 0]), np.array([3.5, 2.25, 1])
    assert ((means >= lower) & (means <= upper)).all()
    np.testing.assert_allclose(means.mean(axis=0), (lower + upper) / 2, atol=0.08)
    np.testing.assert_allclose(means.std(axis=0), (upper - lower) / np.sqrt(12), rtol=0.05)
    # Each has the normal of the nearest photon: here all photons have the same.
    np.testing.assert_array_equal(np.array(g.normals).T, np.tile([0, 0, 1], (2000, 1)))


def test_the_seed_decides():
    settings = make_settings(gaussians=40, initialization="random")
    first, again, other = (
        initialize_gaussians(sheet(100), settings, BOUNDS, seed) for seed in (1, 1, 2)
    )
    for name in ("means", "quats"):
        values = [np.array(getattr(g, name)) for g in (first, again, other)]
        np.testing.assert_array_equal(values[0], values[1])
        assert not np.array_equal(values[0], values[2]), name


@pytest.mark.parametrize("neighbours", [1, 8])
def test_radius_on_an_even_sheet(neighbours):
    count = 20_000
    photons = sheet(count)
    rng = np.random.default_rng(4)
    at = np.column_stack([rng.uniform(0.3, SIZE - 0.3, (3000, 2)), np.full(3000, 0.25)])
    for gaussians in (count, 2500):
        radius = propose_search_radius(photons, gaussians, at, BOUNDS, neighbours)
        # π r² times the density is Gamma(k)-distributed; its median is close to k - 1/3.
        theory = np.sqrt((neighbours - 0.32) * SIZE.prod() / (np.pi * gaussians))
        assert radius == pytest.approx(theory, rel=0.05)


def test_radius_with_fewer_photons_than_neighbours():
    photons = sheet(3)
    at = np.array([[1.0, 1.0, 0.25]])
    farthest = np.linalg.norm(np.array(photons.p).T - at, axis=1).max()
    radius = propose_search_radius(photons, 100, at, BOUNDS)
    assert radius == pytest.approx(farthest, rel=1e-5)


def test_radius_scales_with_the_scene():
    photons = sheet(1000)
    at = np.array(photons.p).T[:200].astype(float)
    small = replace(photons, p=photons.p * 1e-3)
    bounds = tuple(mi.ScalarPoint3f([float(v) * 1e-3 for v in b]) for b in BOUNDS)
    radius = propose_search_radius(photons, 1000, at, BOUNDS)
    tiny = propose_search_radius(small, 1000, at * 1e-3, bounds)
    assert tiny == pytest.approx(1e-3 * radius, rel=1e-4)

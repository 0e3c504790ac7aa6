"""Gaps: supervised points with too few Gaussians around them, and the Gaussians that go there."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy.spatial import cKDTree

from gpf.core.structs import Photons, from_numpy
from gpf.field.field import GaussianPhotonField
from gpf.field.initialization import MOST, SPACING, find_gaps
from gpf.field.settings import FieldSettings
from stages.config.training import InitialFieldSettings
from stages.training.photon_gaussians import initialize_gaussians

BOUNDS = (mi.ScalarPoint3f(-1, -1, -1), mi.ScalarPoint3f(5, 3, 2))
RADIUS = 0.2
K = 3
UP = np.array([0.0, 0, 1])


def sheet(rng, count: int, start: float, stop: float) -> np.ndarray:
    """Points of the plane z = 0 between two values of x, (count, 3)."""
    return np.column_stack(
        [rng.uniform(start, stop, count), rng.uniform(0, 2, count), np.zeros(count)]
    )


def photons_at(p: np.ndarray) -> Photons:
    return Photons(
        p=from_numpy(mi.Point3f, p),
        n=from_numpy(mi.Normal3f, np.tile(UP, (len(p), 1))),
        power=from_numpy(mi.Color3f, np.ones((len(p), 3))),
        depth=dr.zeros(mi.UInt32, len(p)),
    )


def gaussians_at(p: np.ndarray, count: int, gaps: Photons | None = None):
    settings = InitialFieldSettings(
        gaussians=count, initial_colour="density", initial_scale=0.1, search_radius=RADIUS
    )
    return initialize_gaussians(photons_at(p), settings, BOUNDS, 1, gaps)


def field_at(p: np.ndarray, count: int, gaps: Photons | None = None) -> GaussianPhotonField:
    settings = FieldSettings(search_radius=RADIUS, k=K)
    return GaussianPhotonField(gaussians_at(p, count, gaps), settings, BOUNDS)


def test_gaps_are_where_the_search_radius_holds_fewer_than_k():
    rng = np.random.default_rng(3)
    lit = sheet(rng, 3000, 0, 2)
    points = sheet(rng, 4000, 0, 2.9)
    gaps = find_gaps(field_at(lit, 3000), points, np.tile(UP, (4000, 1)), seed=1)
    places = np.array(gaps.p).T
    known = {tuple(row) for row in points.astype(np.float32)}
    assert {tuple(row) for row in places} <= known
    tree = cKDTree(lit.astype(np.float32))
    held = np.array([len(near) for near in tree.query_ball_point(places, RADIUS)])
    assert (held < K).all() and held.max() == K - 1
    # Every point with too few is near one of them: in its cell.
    sparse = points[[len(near) < K for near in tree.query_ball_point(points, RADIUS)]]
    assert len(sparse) > 500
    far, _ = cKDTree(places).query(sparse)
    assert far.max() <= np.sqrt(2) * SPACING * RADIUS
    # One to a cell: not all of them.
    assert len(places) < 0.5 * len(sparse)


def test_what_faces_another_way_is_a_gap_of_its_own():
    rng = np.random.default_rng(3)
    lit = sheet(rng, 3000, 0, 2)
    field = field_at(lit, 3000)
    assert dr.width(find_gaps(field, lit, np.tile(UP, (3000, 1)), seed=1).p) == 0
    below = find_gaps(field, lit, np.tile(-UP, (3000, 1)), seed=1)
    assert dr.width(below.p) > 100
    np.testing.assert_allclose(np.array(below.n).T, np.tile(-UP, (dr.width(below.p), 1)))


def test_with_its_gaps_filled_a_field_knows_all_points():
    rng = np.random.default_rng(3)
    lit = sheet(rng, 8000, 0, 2)
    points, normals = sheet(rng, 4000, 0, 2.5), np.tile(UP, (4000, 1))
    gaps = find_gaps(field_at(lit, 8000), points, normals, seed=1)
    filled = field_at(lit, 8000, gaps)
    assert dr.width(filled.gaussians.means) == 8000
    # Nothing is known of light there but that no photon brought it.
    order = np.argsort(np.array(filled.gaussians.means)[0])[::-1]
    assert np.array(filled.gaussians.irradiance)[:, order[:20]].max() == 0
    x, n = from_numpy(mi.Point3f, points), from_numpy(mi.Normal3f, normals)
    every = dr.full(mi.Bool, True, 4000)
    before, after = (f.query(x, n, every)[1].numpy() for f in (field_at(lit, 8000), filled))
    assert before.max() > 1.5 and np.mean(before > 1) > 0.1
    assert after.max() < 1.5 and np.mean(after > 1) < 0.02


def test_gaps_take_a_part_of_the_gaussians_alone():
    rng = np.random.default_rng(3)
    lit = sheet(rng, 300, 0, 0.5)
    points = sheet(rng, 4000, 1, 4)
    gaps = find_gaps(field_at(lit, 300), points, np.tile(UP, (4000, 1)), seed=1)
    assert dr.width(gaps.p) == MOST * 300
    assert np.ptp(np.array(gaps.p)[0]) > 2  # a choice of all, not the first
    assert np.mean(np.array(gaps.p)[0]) == pytest.approx(2.5, abs=0.5)

"""Cubes are fine where points are dense, and every photon finds its own."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from gpf.core.structs import from_numpy, to_numpy
from gpf.photons.photon_cells import PhotonCells
from gpf.photons.photon_grid import PhotonSums, trace_pass
from gpf.photons.tracing import PathSettings
from gpf.scene.bounds import scene_bounds
from tests.furnace import diffuse, floor, point_light

EDGE = 0.01
BOUNDS = ((-1.0, 0.0, 0.0), (3.0, 1.0, 0.1))


def some_points(count: int = 20_000) -> np.ndarray:
    """On a floor: dense for x < 0, few for 0 < x < 1, none beyond."""
    rng = np.random.default_rng(1)
    dense = rng.uniform([-1, 0], [0, 1], (count, 2))
    few = np.stack(np.meshgrid(*2 * [np.arange(0.03, 1, 0.06)]), axis=-1).reshape(-1, 2)
    x, y = np.concatenate([dense, few]).T
    return np.stack([x, y, np.full(len(x), 0.05)], axis=1)


def find(cells: PhotonCells, p: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    level, corner, inside = cells.find(from_numpy(mi.Point3f, p))
    back = cells.points(level, corner, inside)
    return np.array(level), to_numpy(corner), to_numpy(back)


def test_cubes_are_fine_where_points_are_dense():
    p = np.random.default_rng(2).uniform(*BOUNDS, (5000, 3))
    level, corner, back = find(PhotonCells(EDGE, BOUNDS, some_points()), p)
    np.testing.assert_allclose(back, p, atol=1e-5)
    # 7 mm between points, then 6 cm; near the border, the finer ones.
    assert (level[p[:, 0] < 0] == 0).all()
    assert (level[(p[:, 0] > 0.4) & (p[:, 0] < 0.6)] == 1).all()
    assert (level[p[:, 0] > 1.5] == 2).all()
    edge = EDGE * 2.0 ** level[:, None]
    np.testing.assert_array_less((corner * edge) - 1e-6, p - BOUNDS[0])
    np.testing.assert_array_less(p - BOUNDS[0], (corner + 1) * edge + 1e-6)


def test_without_points_all_are_the_finest():
    p = np.random.default_rng(2).uniform(*BOUNDS, (500, 3))
    level, corner, back = find(PhotonCells(EDGE, BOUNDS), p)
    assert not level.any()
    np.testing.assert_array_equal(corner, np.floor((p - BOUNDS[0]) / EDGE))
    np.testing.assert_allclose(back, p, atol=1e-5)


def test_larger_cubes_lose_no_light():
    """The floor of 6 by 6, with points in one corner of it."""
    shapes = {"floor": floor(diffuse(0.5)), "light": point_light((0, 0, 1), 2, 1, 0.5)}
    scene = mi.load_dict({"type": "scene"} | shapes)
    points = np.random.default_rng(3).uniform([-3, -3, 0], [-2, -2, 0], (50_000, 3))
    found = []
    for near in (None, points):
        sums = PhotonSums(PhotonCells(0.02, scene_bounds(scene), near), PathSettings(60_000))
        trace_pass(scene, 1, 0, sums)
        found.append(sums.photons(0))
    fine, mixed = (to_numpy(photons.power).astype(np.float64) for photons in found)
    assert len(mixed) < 0.4 * len(fine)
    np.testing.assert_allclose(mixed.sum(axis=0), fine.sum(axis=0), rtol=1e-5)
    middle = [
        np.average(to_numpy(f.p)[:, :2], axis=0, weights=to_numpy(f.power)[:, 0]) for f in found
    ]
    np.testing.assert_allclose(middle[1], middle[0], atol=0.02)


def test_a_scene_larger_than_65535_cubes_has_larger_ones():
    long = ((0.0, 0.0, 0.0), (1.0, 0.1, 0.1))
    p = np.array([[0.999, 0.05, 0.05], [0.5, 0.01, 0.09]])
    _, corner, back = find(PhotonCells(1e-6, long), p)
    np.testing.assert_allclose(back, p, atol=1e-5)
    assert corner.max() <= 65535

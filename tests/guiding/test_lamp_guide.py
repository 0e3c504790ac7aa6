"""Guided samples of the emitters: the same mean, with less noise behind a window."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.core.structs import VisiblePoints, from_numpy, to_numpy
from gpf.guiding.lamp_guide import SIDE, UNIFORM, LampGuide, count_bins, find_cells
from gpf.scene.lamps import Lamps
from gpf.sppm.fixed_points import FixedPoints
from gpf.training.direct_light import DirectLight

POINTS = 6000


def uniform(seed: int, count: int) -> np.ndarray:
    return np.random.default_rng(seed).random((count, 2)).astype(np.float32)


def learn(light, cells: int = 1) -> LampGuide:
    """A guide that knows ``light(u, cell)`` from many samples."""
    u, cell = uniform(0, 400_000), np.arange(400_000) % cells
    return LampGuide(cell[:POINTS], *count_bins(cell, u, light(u, cell)))


def corner(u: np.ndarray, cell: np.ndarray) -> np.ndarray:
    """Light from a corner of the square, another one in each cell."""
    side = np.where(cell == 0, 0.1, 0.9)
    return np.where(np.abs(u - side[:, None]).max(axis=1) < 0.1, 25.0, 0.0)


def test_the_mean_stays_and_the_noise_goes():
    guide = learn(corner, cells=2)
    u, cell = uniform(1, POINTS), np.arange(POINTS) % 2
    guided, weight = guide.warp(from_numpy(mi.Point2f, u))
    light = corner(to_numpy(guided), cell) * weight.numpy()
    for own in (0, 1):
        assert light[cell == own].mean() == pytest.approx(1, abs=0.03)
    assert light.std() < 0.2 * corner(u, cell).std()
    assert guide.remaining < 0.1


def test_every_part_of_the_square_stays_possible():
    """The weight is the inverse of the density."""
    guide = learn(corner)
    u = uniform(2, POINTS)
    guided, weight = guide.warp(from_numpy(mi.Point2f, u))
    place = np.minimum((to_numpy(guided) * SIDE).astype(int), SIDE - 1)
    chance = guide.chance[0, place[:, 0], place[:, 1]]
    np.testing.assert_allclose(weight.numpy(), 1 / (chance * SIDE**2), rtol=1e-3)
    assert weight.numpy().mean() == pytest.approx(1, abs=0.05)
    assert to_numpy(guided).min() >= 0 and to_numpy(guided).max() < 1
    assert weight.numpy().max() < 1.01 / UNIFORM


@pytest.mark.parametrize("edge", [0.0, np.nextafter(np.float32(1), np.float32(0))])
def test_numbers_at_the_edge_of_the_square_stay_inside(edge):
    guide = learn(corner)
    guided, weight = guide.warp(from_numpy(mi.Point2f, np.full((POINTS, 2), edge, np.float32)))
    assert to_numpy(guided).min() >= 0 and to_numpy(guided).max() < 1
    assert np.isfinite(weight.numpy()).all()


def test_a_scene_without_light_is_sampled_evenly():
    guide = learn(lambda u, cell: np.zeros(len(u)))
    u = uniform(3, POINTS)
    guided, weight = guide.warp(from_numpy(mi.Point2f, u))
    np.testing.assert_allclose(to_numpy(guided), u, atol=1e-5)
    np.testing.assert_allclose(weight.numpy(), 1, rtol=1e-5)


def test_cells_have_enough_points_and_tell_orientations_apart():
    p = np.column_stack([uniform(4, 20_000), np.zeros(20_000)])
    n = np.tile([0.0, 0.0, 1.0], (20_000, 1))
    n[::2] *= -1
    cell = find_cells(p, n)
    assert 20 < len(np.unique(cell)) <= 20_000 / 300
    assert not set(cell[::2]) & set(cell[1::2])


@pytest.fixture(scope="module")
def room() -> FixedPoints:
    """The floor of a dark room, with a window in one wall, under an even sky."""
    T = mi.ScalarTransform4f
    wall = T().translate([2, 1, 0]).rotate([0, 1, 0], -90)
    parts = {
        "floor": T().rotate([1, 0, 0], -90).scale([2, 2, 1]),
        "ceiling": T().translate([0, 2, 0]).rotate([1, 0, 0], 90).scale([2, 2, 1]),
        "back": T().translate([-2, 1, 0]).rotate([0, 1, 0], 90).scale([2, 1, 1]),
        "left": T().translate([0, 1, -2]).scale([2, 1, 1]),
        "right": T().translate([0, 1, 2]).rotate([0, 1, 0], 180).scale([2, 1, 1]),
        # Around a window of 0.6 by 0.5.
        "below": wall.translate([0, -0.7, 0]).scale([2, 0.3, 1]),
        "above": wall.translate([0, 0.6, 0]).scale([2, 0.4, 1]),
        "before": wall.translate([-1.3, 0, 0]).scale([0.7, 1, 1]),
        "behind": wall.translate([1.3, 0, 0]).scale([0.7, 1, 1]),
    }
    shapes = {name: {"type": "rectangle", "to_world": T(to)} for name, to in parts.items()}
    scene = mi.load_dict({"type": "scene", "sky": {"type": "constant"}} | shapes)
    rng = np.random.default_rng(0)
    points = dr.zeros(VisiblePoints, POINTS)
    x, z = np.sort(rng.uniform(-1.9, 1.5, POINTS)), rng.uniform(-1.9, 1.9, POINTS)
    points.p = mi.Point3f(x, 0, z)
    points.n = mi.Normal3f([0] * POINTS, [1] * POINTS, [0] * POINTS)
    return FixedPoints(scene, points)


def test_light_through_a_window_has_less_noise_and_the_same_mean(room):
    lamps = Lamps(room.scene)
    direct = DirectLight(room, lamps, 1, seed=3)
    direct.sample(1)
    exact = room.mean_direct(lamps, 2048, seed=9)[:, 0]
    plain = room.mean_direct(lamps, direct.samples, seed=5)[:, 0]
    guided = direct.mean(0)[:, 0]
    errors = [found - exact for found in (guided, plain)]
    assert np.square(errors[0]).mean() < 0.25 * np.square(errors[1]).mean()
    assert guided.mean() == pytest.approx(exact.mean(), rel=0.03)


def test_a_lamp_that_every_point_sees_needs_no_guide(room):
    to_world = mi.ScalarTransform4f().rotate([1, 0, 0], -90).scale(9)
    floor = {"type": "rectangle", "to_world": to_world}
    lamp = {"type": "point", "position": [0, 3, 0]}
    scene = mi.load_dict({"type": "scene", "floor": floor, "lamp": lamp})
    assert DirectLight(FixedPoints(scene, room.points), Lamps(scene), 1, seed=3)._guide is None

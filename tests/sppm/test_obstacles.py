"""What stands on a surface hides what is behind it, and nothing else."""

from __future__ import annotations

from functools import partial

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.core.structs import VisiblePoints, from_numpy
from gpf.sppm.edge_correction import covered_share
from gpf.sppm.obstacles import Obstacles
from gpf.sppm.passes import PassSettings
from gpf.training.streaming import PhotonStream
from tests.furnace import diffuse, floor, rectangle

REACH = 0.2
UP = (0.0, 0.0, 1.0)
PLATE = floor(diffuse(0.5), size=4)


def upright(x, y, size, turn=0.0):
    """A square that stands on the plate."""
    at = mi.ScalarTransform4f().translate([x, y, 0]).rotate(UP, turn)
    at = at.rotate([1, 0, 0], 90).scale([size / 2, size, 1])
    return {"type": "rectangle", "to_world": at, "bsdf": diffuse(0.5)}


def look(shapes, places, normal=UP):
    """The obstacles of places, and the arguments of :meth:`Obstacles.hide` for all of them."""
    scene = mi.load_dict({"type": "scene"} | shapes)
    p = from_numpy(mi.Point3f, np.asarray(places, np.float32))
    n = from_numpy(mi.Normal3f, np.tile(np.float32(normal), (len(places), 1)))
    return scene, p, n, Obstacles(scene, p, n, REACH)


def disc(count):
    """Offsets that fill a disc evenly, (N, 3)."""
    rng = np.random.default_rng(0)
    radius, turn = REACH * np.sqrt(rng.random(count)), rng.uniform(0, 2 * np.pi, count)
    return np.stack([radius * np.cos(turn), radius * np.sin(turn), 0 * turn], axis=1)


@pytest.mark.parametrize("turn", [0, 17, 45, 80])
@pytest.mark.parametrize("distance", [0.002, 0.05, 0.12])
def test_behind_a_wall_is_behind_its_plane(distance, turn):
    """Whatever its direction."""
    cosine, sine = np.cos(np.deg2rad(turn)), np.sin(np.deg2rad(turn))
    away = np.array([sine, -cosine, 0])  # from the wall
    shapes = {"plate": PLATE, "wall": upright(0, 0, 4, turn)}
    offsets = disc(20_000)
    _, _, n, obstacles = look(shapes, [distance * away] * len(offsets))
    assert obstacles.near.all()
    row = dr.arange(mi.UInt32, len(offsets))
    found = np.array(obstacles.hide(row, n, from_numpy(mi.Vector3f, offsets.astype(np.float32))))
    height = offsets @ away + distance  # above the wall's plane
    assert not found[height > 1e-6].any()  # as far as single precision tells
    assert found[height < 0].mean() > 0.99


def test_nothing_is_near_on_a_free_surface_or_far_from_an_obstacle():
    shapes = {"plate": PLATE, "wall": upright(0, 0, 4)}
    _, _, _, obstacles = look(shapes, [(0, 0.21, 0), (0.5, 0.19, 0), (1, -0.3, 0)])
    np.testing.assert_array_equal(obstacles.near, [False, True, False])


def test_a_surface_is_no_obstacle_to_itself():
    """A bowl rises before each of its points, and a carpet has no free place at all."""
    bowl = {"type": "sphere", "radius": 0.5, "flip_normals": True, "bsdf": diffuse(0.5)}
    _, _, _, obstacles = look({"bowl": bowl}, [(0, 0, -0.5)])
    assert not obstacles.near.any()
    blades = {f"blade{k}": upright(0, 0.02 * k, 1) for k in range(-20, 20)}
    _, _, _, obstacles = look({"plate": PLATE} | blades, [(0, 0.01, 0)])
    assert not obstacles.near.any()


@pytest.mark.parametrize("distance", [0.0005, 0.05, 0.1, 0.15])
def test_the_share_of_the_disc_in_front_of_a_wall(distance):
    """As at the edge of a plate, of a disc whose places count less towards its rim."""
    rng = np.random.default_rng(0)
    radii = REACH * np.sqrt(1 - np.sqrt(rng.random(500_000)))
    expected = np.mean(radii * np.cos(rng.uniform(0, 2 * np.pi, 500_000)) < distance)
    places = [(x, distance, 0) for x in np.linspace(-1, 1, 20_000)]
    scene, p, n, obstacles = look({"plate": PLATE, "wall": upright(0, 0, 4)}, places)
    row = dr.arange(mi.UInt32, len(places))
    share = covered_share(scene, p, n, REACH, 1, 32, partial(obstacles.hide, row, n)).numpy()
    assert share.mean() == pytest.approx(expected, abs=5e-3)
    assert share.std() < 0.08 * expected


def test_light_neither_leaks_under_a_wall_nor_darkens_before_it():
    """Light falls straight down on one side; a roof keeps it from the other. Under the wall, which
    is thinner than the kernel, the floor goes on."""
    wall = {"type": "cube", "to_world": mi.ScalarTransform4f().translate([0, 0, 0.5])}
    wall["to_world"] = wall["to_world"] @ mi.ScalarTransform4f().scale([2, 0.01, 0.5])
    roof = rectangle((0, 1, 1.01), (0, 1, 0), 4, 2, diffuse(0.0))
    light = {"type": "directional", "direction": [0, 0, -1], "irradiance": 2.0}
    shapes = {"plate": PLATE, "wall": wall | {"bsdf": diffuse(0.0)}, "roof": roof, "light": light}
    scene = mi.load_dict({"type": "scene"} | shapes)
    rng = np.random.default_rng(1)
    side = np.repeat([-1.0, 1.0], 2000)
    distance = rng.uniform(0.011, 0.2, 4000)
    place = np.stack([rng.uniform(-1, 1, 4000), side * distance, 0 * side], 1)
    points = dr.zeros(VisiblePoints, 4000)
    points.p = from_numpy(mi.Point3f, place.astype(np.float32))
    points.n = from_numpy(mi.Normal3f, np.tile(np.float32(UP), (4000, 1)))
    points.valid, points.reflectance = dr.full(mi.Bool, True, 4000), mi.Color3f(0.5)
    dr.make_opaque(points)
    settings = PassSettings(photons_per_pass=200_000, initial_radius=0.1, direct="photons")
    stream = PhotonStream(scene, settings, {"view": points}, seed=3)
    stream.advance(4)
    targets = stream.mean(stream.halves())
    found = targets.irradiance[:, 0]
    y = targets.position[:, 1]
    for low, high in ((0.011, 0.02), (0.02, 0.04), (0.04, 0.08), (0.08, 0.2)):
        lit = (y < -low) & (y > -high)
        assert found[lit].mean() == pytest.approx(2, rel=0.03), (low, high)
        assert found[(y > low) & (y < high)].mean() < 0.03, (low, high)

"""Gaussians end at what stands on their surface."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.core.structs import from_numpy, take, to_numpy
from gpf.field.by_detail import place_by_detail
from gpf.field.detail import Detail
from gpf.field.field import GaussianPhotonField
from gpf.field.io import load_field, save_field
from gpf.field.limits import (
    find_limits,
    find_limits_in_space,
    fold,
    nearest_obstacles,
    no_limits,
)
from gpf.field.settings import FieldSettings
from gpf.training.blend_matrix import blend_matrix
from tests.plain_field import flat_gaussians, make_field, surface_points

WALL, RADIUS = 0.02, 0.3
"""A wall between x = 0 and its thickness."""


@pytest.fixture(scope="module")
def scene() -> mi.Scene:
    """A floor, z = 0, with a thin wall on it."""
    wall = mi.ScalarTransform4f().translate([WALL / 2, 0, 0.5]).scale([WALL / 2, 1, 0.5])
    return mi.load_dict(
        {
            "type": "scene",
            "floor": {"type": "rectangle"},
            "wall": {"type": "cube", "to_world": wall},
        }
    )


def planes_at(scene: mi.Scene, places: np.ndarray) -> np.ndarray:
    """On the floor, (N, 4)."""
    p = from_numpy(mi.Point3f, places)
    n = from_numpy(mi.Normal3f, np.tile([0.0, 0, 1], (len(places), 1)))
    return nearest_obstacles(scene, p, n, dr.full(mi.Float, RADIUS, len(places)))


def lit_on_one_side(scene: mi.Scene) -> GaussianPhotonField:
    """Gaussians on the floor, wider than the wall is thick, bright on the left of it alone."""
    x, y = np.meshgrid(np.arange(-0.475, 0.5, 0.05), np.arange(-0.475, 0.5, 0.05))
    places = np.column_stack([x.ravel(), y.ravel(), 0 * x.ravel()])
    bright = np.where(places[:, :1] < 0, 1.0, 0.001) * np.ones(3)
    plain = make_field(
        flat_gaussians(places, bright, size=0.1), FieldSettings(search_radius=RADIUS)
    )
    limits = no_limits(len(places))
    limits[:, 0] = planes_at(scene, places)
    limits[:, 0, 3] += (limits[:, 0, :3] * places).sum(axis=1)
    return GaussianPhotonField(plain.gaussians, plain.settings, plain.bounds, limits=limits)


def ask(field: GaussianPhotonField, x: np.ndarray) -> np.ndarray:
    up = from_numpy(mi.Normal3f, np.tile([0.0, 0, 1], (len(x), 1)))
    return to_numpy(field.query(from_numpy(mi.Point3f, x), up, dr.full(mi.Bool, True, len(x)))[0])


def test_the_nearest_obstacle_is_found(scene):
    planes = planes_at(scene, np.array([[-0.1, 0, 0], [0.25, 0.3, 0], [-0.5, 0, 0]]))
    np.testing.assert_allclose(planes[0], [1, 0, 0, 0.1], atol=1e-5)
    np.testing.assert_allclose(planes[1], [-1, 0, 0, 0.25 - WALL], atol=1e-5)
    np.testing.assert_array_equal(planes[2], 0)


def test_what_hides_little_ends_nothing():
    """A leg of a table, which hides a few percent, has no plane; the wall behind it does."""
    leg = mi.ScalarTransform4f().translate([0, 0, 0.5]).scale([0.02, 0.02, 0.5])
    wall = mi.ScalarTransform4f().translate([0.21, 0, 0.5]).scale([0.01, 2, 0.5])
    shapes = {
        "floor": {"type": "rectangle"},
        "leg": {"type": "cube", "to_world": leg},
        "wall": {"type": "cube", "to_world": wall},
    }
    rng = np.random.default_rng(4)
    turn, away = rng.uniform(0, 2 * np.pi, 2000), np.sqrt(rng.uniform(0.06**2, 0.15**2, 2000))
    places = np.column_stack([away * np.cos(turn), away * np.sin(turn), 0 * turn])
    planes = planes_at(mi.load_dict({"type": "scene"} | shapes), places)
    at_wall = 0.2 - places[:, 0]
    by_wall = np.abs(planes - np.column_stack([0 * places + [1, 0, 0], at_wall])).max(axis=1) < 1e-5
    assert by_wall[at_wall < 0.8 * RADIUS].mean() > 0.9  # between both, more is hidden
    del shapes["wall"]
    assert not planes_at(mi.load_dict({"type": "scene"} | shapes), places).any()


def test_no_light_comes_from_behind_a_wall(scene):
    field = lit_on_one_side(scene)
    y = np.linspace(-0.4, 0.4, 33)
    for x, light in ((-0.005, 1.0), (-0.1, 1.0), (WALL + 0.005, 0.001), (0.1, 0.001)):
        places = np.column_stack([0 * y + x, y, 0 * y])
        np.testing.assert_allclose(ask(field, places), light, rtol=1e-4)
    leaks = GaussianPhotonField(field.gaussians, field.settings, field.bounds)
    assert (ask(leaks, places) > 0.01).all()


def test_a_niche_without_gaussians_of_its_own_is_not_black(scene):
    field = lit_on_one_side(scene)
    left = np.flatnonzero(to_numpy(field.gaussians.means)[:, 0] < 0)
    alone = take(field.gaussians, from_numpy(mi.UInt32, left))
    field = GaussianPhotonField(alone, field.settings, field.bounds, limits=field.limits[left])
    np.testing.assert_allclose(ask(field, np.array([[WALL + 0.005, 0, 0]])), 1, rtol=1e-4)


def test_training_sees_what_queries_see(scene):
    field = lit_on_one_side(scene)
    rng = np.random.default_rng(3)
    places = np.column_stack([rng.uniform(-0.45, 0.45, (200, 2)), np.zeros(200)])
    up = np.tile([0.0, 0, 1], (200, 1))
    matrix = blend_matrix(field, surface_points(places, up, np.ones((200, 3))))
    found = matrix @ to_numpy(field.gaussians.irradiance)
    np.testing.assert_allclose(found, ask(field, places), rtol=1e-4)


def test_planes_of_all_levels_are_at_the_wall(scene):
    """In the unfolded space, where the wall's left side lies elsewhere for each level."""
    table = np.array([0, 1, 2, 1], np.uint8).reshape(1, 4, 1)
    detail = Detail(table, 0.5, np.array([-1.0, -1.0, -0.5]), RADIUS)
    rng = np.random.default_rng(2)
    places = np.column_stack(
        [rng.uniform(-0.05, 0, 2000), rng.uniform(-0.9, 0.9, 2000), np.zeros(2000)]
    )
    g = place_by_detail(detail, places, np.tile([0.0, 0, 1], (2000, 1)), seed=1)
    planes = find_limits(scene, g, detail)[:, 0]
    levels = detail.levels_of(to_numpy(g.means))
    assert set(levels) == {0, 1, 2}
    np.testing.assert_allclose(planes[:, :3], np.tile([1, 0, 0], (len(planes), 1)), atol=1e-5)
    at_wall = (0 - detail.corner[0]) * 2.0**levels + detail.starts[levels]
    np.testing.assert_allclose(planes[:, 3], at_wall, atol=1e-4)


def in_fog(scene: mi.Scene, places: np.ndarray, bright: np.ndarray) -> GaussianPhotonField:
    """Gaussians in the air, all of the same level."""
    low = places.min(axis=0) - 0.1
    detail = Detail(np.zeros((4, 4, 4), np.uint8), np.ptp(places, axis=0).max(), low, RADIUS)
    gaussians = flat_gaussians(places, bright, size=0.1)
    own = FieldSettings(search_radius=RADIUS, normal_test=False)
    plain = make_field(gaussians, own, detail=detail)
    plain.gaussians.means = from_numpy(mi.Point3f, detail.unfold_all(places, 0))
    limits = find_limits_in_space(scene, plain.gaussians, detail, 4)
    return GaussianPhotonField(plain.gaussians, own, plain.bounds, detail=detail, limits=limits)


def test_fog_behind_a_thin_wall_is_dark(scene):
    """On the far side, there are no Gaussians at all, and no light either."""
    x, y, z = np.meshgrid(*[np.arange(-0.45, 0.5, 0.1)] * 3)
    places = np.column_stack([x.ravel(), y.ravel(), z.ravel() + 0.5])
    places = places[places[:, 0] < 0]
    field = in_fog(scene, places, np.ones((len(places), 3)))
    near = np.array([[-0.01, 0, 0.4], [-0.3, 0.2, 0.6]])
    np.testing.assert_allclose(ask(field, near), 1, rtol=1e-4)
    beyond = np.array([[WALL + 0.01, 0, 0.4], [0.2, 0.1, 0.5]])
    np.testing.assert_array_equal(ask(field, beyond), 0)
    free = in_fog(mi.load_dict({"type": "scene"}), places, np.ones((len(places), 3)))
    assert free.limits is None and ask(free, beyond).min() > 0.99


def test_what_is_smaller_than_a_wall_does_not_end_fog():
    rod = {"type": "cylinder", "p0": [0.1, 0, -1], "p1": [0.1, 0, 1], "radius": 0.01}
    places = np.array([[0.0, 0, 0], [0.05, 0.1, 0.1]])
    field = in_fog(mi.load_dict({"type": "scene", "rod": rod}), places, np.ones((2, 3)))
    assert field.limits is None


def test_surfaces_over_and_under_one_end_it():
    """A shelf a little over a floor, both of which face up: no light comes from the one to the
    other, nor from where one is alone."""
    gap, radius = 0.05, 0.3
    shelf = mi.ScalarTransform4f().translate([-0.5, 0, gap]).scale([0.5, 1, 1])
    scene = mi.load_dict(
        {
            "type": "scene",
            "floor": {"type": "rectangle"},
            "shelf": {"type": "rectangle", "to_world": shelf},
        }
    )
    detail = Detail(np.zeros((1, 1, 1), np.uint8), 4.0, np.array([-2.0, -2.0, -2.0]), radius)
    x, y = (v.ravel() for v in np.meshgrid(*2 * [np.linspace(-0.9, 0.9, 37)]))
    left = x < 0
    floor, above = np.column_stack([x, y, 0 * x]), np.column_stack([x, y, 0 * x + gap])[left]
    places = np.concatenate([floor, above])
    g = place_by_detail(detail, places, np.tile([0.0, 0, 1], (len(places), 1)), seed=1)
    limits = find_limits(scene, g, detail)
    mean = detail.fold(to_numpy(g.means))
    under, over = (mean[:, 0] < -0.05) & (mean[:, 2] < gap / 2), mean[:, 2] > gap / 2
    open_floor = mean[:, 0] > 0.05
    up, down = fold(limits, to_numpy(g.means), detail)[:, 1:].swapaxes(0, 1)
    np.testing.assert_allclose(up[under], [[0, 0, 1, 0.75 * gap]] * under.sum(), atol=1e-5)
    np.testing.assert_allclose(down[over], [[0, 0, -1, 0.75 * gap]] * over.sum(), atol=1e-5)
    assert not up[open_floor].any() and not down[open_floor].any()

    light = np.where(over, 1.0, 0.001)[:, None] * np.ones(3)
    g.irradiance = from_numpy(mi.Color3f, light)
    bounds = (mi.ScalarPoint3f(-1), mi.ScalarPoint3f(1))
    settings = FieldSettings(search_radius=radius)
    field = GaussianPhotonField(g, settings, bounds, detail=detail, limits=limits)
    row = np.linspace(-0.8, -0.35, 50)  # farther from the open floor than the radius
    for height, seen in ((0, 0.001), (gap, 1.0)):
        np.testing.assert_allclose(
            ask(field, np.column_stack([row, 0.3 * row, 0 * row + height])), seen, rtol=1e-3
        )
    leaks = GaussianPhotonField(g, settings, bounds, detail=detail)
    assert (ask(leaks, np.column_stack([row, 0.3 * row, 0 * row])) > 0.05).all()


@pytest.mark.parametrize(("precision", "within"), [("float32", 1e-6), ("compact", 6e-3)])
def test_limits_travel_in_both_precisions(scene, tmp_path, precision, within):
    field, path = lit_on_one_side(scene), tmp_path / "field.safetensors"
    save_field(field, path, precision)
    loaded = load_field(path)
    np.testing.assert_allclose(loaded.limits, field.limits, atol=within)
    save_field(loaded, tmp_path / "again.safetensors", precision)
    if precision == "compact":
        assert (tmp_path / "again.safetensors").read_bytes() == path.read_bytes()

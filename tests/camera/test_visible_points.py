"""Camera rays to their first diffuse hits: where they end, and with what weight."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.camera.visible_points import find_visible_points
from gpf.core.structs import from_numpy, to_numpy
from tests.camera.walks import GLASS, MIRROR, is_valid, spread, walk
from tests.furnace import diffuse, floor, interaction, lamp, rectangle, rgb, room, two_sided

# --- where rays end ---------------------------------------------------------------------------


def test_a_diffuse_surface_ends_the_ray_at_once():
    points = walk({"floor": floor(diffuse(0.6, 0.4, 0.2))}, (0, -1, 1), (0.5, 0.2, 0))
    assert is_valid(points).all()
    np.testing.assert_allclose(spread(points.p), [[0.5, 0.2, 0]] * 20_000, atol=1e-5)
    np.testing.assert_allclose(spread(points.n)[0], [0, 0, 1], atol=1e-6)
    np.testing.assert_allclose(spread(points.reflectance)[0], [0.6, 0.4, 0.2], rtol=1e-5)
    np.testing.assert_array_equal(spread(points.throughput), 1)
    np.testing.assert_array_equal(spread(points.emission), 0)
    np.testing.assert_array_equal(spread(points.depth), 0)


@pytest.mark.parametrize("side", [1, -1])
def test_the_normal_is_on_the_viewers_side(side):
    points = walk({"floor": floor(two_sided(0.5))}, (0.3, -1, side), (0, 0, 0))
    assert is_valid(points).all()
    np.testing.assert_allclose(spread(points.n)[0], [0, 0, side], atol=1e-6)


def test_the_back_of_a_one_sided_surface_is_black():
    points = walk({"floor": floor(diffuse(0.5))}, (0.3, -1, -1), (0, 0, 0))
    assert not is_valid(points).any()
    np.testing.assert_array_equal(to_numpy(points.radiance(mi.Color3f(1))), 0)


def test_rays_that_escape_are_not_valid():
    scene = {"floor": floor(MIRROR), "sky": {"type": "constant", "radiance": rgb(1, 2, 3)}}
    for target, expected in (((0, 0, 1), [1, 2, 3]), ((0, 0, 0), [0.9, 1.2, 0.9])):
        points = walk(scene, (0, -1, 0.5), target)
        assert not is_valid(points).any()
        radiance = np.broadcast_to(to_numpy(points.radiance(mi.Color3f(100))), (20_000, 3))
        np.testing.assert_allclose(radiance, [expected] * 20_000, rtol=1e-5)


def test_inactive_lanes_stay_out():
    loaded = mi.load_dict({"type": "scene", "floor": floor(diffuse(0.5))})
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(0, 6)
    active = mi.Bool([True, False, True, True, False, False])
    ray = mi.Ray3f(mi.Point3f(0, 0, dr.full(mi.Float, 1, 6)), mi.Vector3f(0, 0, -1))
    points, _ = find_visible_points(loaded, sampler, ray, active=active)
    assert points.valid.numpy().tolist() == active.numpy().tolist()


def test_a_mirror_is_followed():
    """The wall in the mirror: reflected position, the mirror's colour, one bounce."""
    wall = rectangle((0, 2, 0), (0, 0, 0), 8, 8, diffuse(0.5))
    points = walk({"mirror": floor(MIRROR), "wall": wall}, (0.2, -1, 1), (0.2, 0, 0))
    assert is_valid(points).all()
    np.testing.assert_allclose(spread(points.p)[0], [0.2, 2, 2], atol=1e-3)
    np.testing.assert_allclose(spread(points.n)[0], [0, -1, 0], atol=1e-6)
    np.testing.assert_allclose(spread(points.throughput)[0], [0.9, 0.6, 0.3], rtol=1e-5)
    np.testing.assert_array_equal(spread(points.depth), 1)


# --- weights ----------------------------------------------------------------------------------


@pytest.mark.parametrize("slant", [0.0, 0.8, 3.0])
def test_a_glass_pane_divides_as_fresnel_says(slant):
    """R + T R T … of the two faces; behind the pane radiance is what it was."""
    pane = {"type": "cube", "to_world": mi.ScalarTransform4f().scale([50, 50, 0.05]), "bsdf": GLASS}
    box = room(diffuse(0.5), half=(60, 60, 4))
    points = walk({"pane": pane, "box": box}, (0, 0, 1), (slant, 0, 0), rr_depth=1000)
    assert is_valid(points).all()
    r = float(mi.fresnel(mi.Float(1 / math.hypot(1, slant)), mi.Float(1.5))[0][0])
    reflected = spread(points.p)[:, 2] > 0
    expected = 2 * r / (1 + r)
    noise = math.sqrt(expected * (1 - expected) / 20_000)
    weight = spread(points.throughput)[:, 0]
    assert (weight * reflected).mean() == pytest.approx(expected, abs=4 * noise + 1e-4)
    assert (weight * ~reflected).mean() == pytest.approx(1 - expected, abs=4 * noise + 1e-4)
    # One side of the glass only: radiance in the glass carries n².
    entered = spread(points.depth)[~reflected]
    assert (entered % 2 == 0).all() and (entered >= 2).all()


def test_radiance_in_glass_carries_the_square_of_the_index():
    """A diffuse floor at the bottom of a block of glass: β = T / n² on the way in."""
    scene = {"water": floor(GLASS, z=0, size=40), "ground": floor(diffuse(0.5), z=-1, size=40)}
    points = walk(scene, (0, 0, 1), (0, 0, 0))
    valid = is_valid(points)
    assert valid.mean() == pytest.approx(0.96, abs=0.01)
    np.testing.assert_allclose(spread(points.throughput)[valid], 1 / 1.5**2, rtol=1e-5)


def test_roulette_does_not_change_the_mean():
    """Through many dark mirrors; the first bounces are spared."""
    scene = {
        "low": floor(MIRROR, z=0, size=100),
        "high": floor({"type": "twosided", "m": MIRROR}, z=1, size=100),
        "wall": rectangle((0, 22, 0), (0, 0, 0), 100, 100, diffuse(0.5)),
    }
    means = []
    for rr_depth in (1, 4, 1000):
        points = walk(scene, (0, 0, 0.5), (0, 1, 0), rr_depth=rr_depth)
        assert (spread(points.depth)[is_valid(points)] == 11).all()
        means.append((spread(points.throughput) * is_valid(points)[:, None]).mean(0))
    assert means[2] == pytest.approx(np.array([0.9, 0.6, 0.3]) ** 11, rel=1e-4)
    assert means[0] == pytest.approx(means[2], rel=0.03)
    assert means[1] == pytest.approx(means[2], rel=0.03)


def test_a_rough_conductor_is_followed():
    """Where the sampled directions hit the surrounding wall, β is the lobe's albedo on average."""
    rough = {"type": "roughconductor", "material": "Al", "alpha": 0.3, "distribution": "ggx"}
    box = room(diffuse(0.5), half=(60, 60, 60))
    sheet = floor({"type": "twosided", "m": rough}, size=10)
    points = walk({"sheet": sheet, "box": box}, (0, -1, 1), (0, 0, 0))
    assert (spread(points.depth)[is_valid(points)] == 1).mean() > 0.99
    bsdf = mi.load_dict(rough)
    wi = np.tile([0, -math.sqrt(0.5), math.sqrt(0.5)], (200_000, 1))
    rng = np.random.default_rng(2)
    u = from_numpy(mi.Point2f, rng.random((200_000, 2)))
    _, weight = bsdf.sample(mi.BSDFContext(), interaction(wi), mi.Float(0.5), u)
    albedo = spread(weight, 200_000).mean(0)
    assert 0.7 < albedo[0] < 0.95
    found = (spread(points.throughput) * is_valid(points)[:, None]).mean(0)
    np.testing.assert_allclose(found, albedo, rtol=5e-3)


def test_a_lamp_is_seen_directly_in_a_mirror_and_through_glass():
    light = lamp((0, 2, 1), (0, 0, 1), 1.9, 5, 6, 7)
    direct = walk({"lamp": light}, (0, -1, 1), (0, 2, 1))
    np.testing.assert_allclose(spread(direct.emission)[0], [5, 6, 7], rtol=1e-5)

    mirrored = walk({"lamp": light, "floor": floor(MIRROR, size=10)}, (0, -1, 0.5), (0, 0, 0))
    np.testing.assert_allclose(
        spread(mirrored.emission)[0], np.array([5, 6, 7]) * [0.9, 0.6, 0.3], rtol=1e-5
    )

    pane = rectangle((0, 1, 1), (0, 0, 1), 3, 3, {"type": "thindielectric", "int_ior": 1.5})
    behind = walk({"lamp": light, "pane": pane}, (0, -1, 1), (0, 2, 1))
    mean = spread(behind.emission).mean(0)
    np.testing.assert_allclose(mean, np.array([5, 6, 7]) * (1 - 2 * 0.04 / 1.04), rtol=5e-3)


def test_a_lamp_that_reflects_is_lamp_and_visible_point():
    light = lamp((0, 2, 1), (0, 0, 1), 2, 5, 6, 7, bsdf=diffuse(0.5))
    points = walk({"lamp": light}, (0, -1, 1), (0, 2, 1))
    assert is_valid(points).all()
    radiance = to_numpy(points.radiance(mi.Color3f(np.pi)))
    np.testing.assert_allclose(radiance, [[5.5, 6.5, 7.5]] * 20_000, rtol=1e-5)


def test_the_back_of_a_lamp_is_dark():
    points = walk({"lamp": lamp((0, 2, 1), (0, 0, 1), 2, 5, 6, 7)}, (0, 5, 1), (0, 2, 1))
    np.testing.assert_array_equal(spread(points.emission), 0)


@pytest.mark.parametrize(
    ("max_depth", "emission", "depth"),
    [
        (0, 0, None),
        (1, 0, None),
        (2, 0, None),
        (3, 0.9**2 * 5, None),
        (4, 0.9**2 * 5, 2),
        (-1, 0.9**2 * 5, 2),
    ],
)
def test_walks_end_after_max_depth_edges(max_depth, emission, depth):
    """Two mirrors, then a lamp that reflects too.

    To see the lamp takes three edges, to see light on it four.
    """
    scene = {
        "low": floor(MIRROR, z=0, size=20),
        "high": floor({"type": "twosided", "m": MIRROR}, z=1, size=20),
        "lamp": lamp((0, 2.2, 0.5), (0, 0, 0.5), 0.99, 5, 5, 5, bsdf=diffuse(0.5)),
    }
    points = walk(scene, (0, 0, 0.5), (0, 0.5, 0), max_depth=max_depth, rr_depth=1000)
    assert spread(points.emission)[0, 0] == pytest.approx(emission, rel=1e-5)
    valid = is_valid(points)
    assert (valid.all() and (spread(points.depth) == depth).all()) if depth else not valid.any()

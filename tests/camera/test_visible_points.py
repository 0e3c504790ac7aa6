"""Camera rays to their first diffuse hits: where they end, and with what weight."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.camera.visible_points import find_visible_points, follow
from gpf.core.structs import VisiblePoints, from_numpy, to_numpy
from gpf.scene.materials import specular_context
from tests.furnace import (
    Scene,
    diffuse,
    floor,
    interaction,
    lamp,
    rectangle,
    rgb,
    room,
    two_sided,
)

MIRROR = {"type": "conductor", "material": "none", "specular_reflectance": rgb(0.9, 0.6, 0.3)}
GLASS = {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}


def walk(
    scene: Scene,
    origin: tuple[float, float, float],
    target: tuple[float, float, float],
    count: int = 20_000,
    seed: int = 1,
    **options: int | bool | None,
) -> VisiblePoints:
    """``count`` walks that begin with the same ray."""
    loaded = mi.load_dict({"type": "scene"} | scene)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, count)
    d = np.subtract(target, origin) / np.linalg.norm(np.subtract(target, origin))
    ray = mi.Ray3f(mi.Point3f(*origin), mi.Vector3f(*d.tolist()))
    ray = dr.gather(mi.Ray3f, ray, dr.zeros(mi.UInt32, count))
    points, way = follow(loaded, sampler, ray, **options)
    dr.eval(points, way)
    points.share = way.weight
    return points


def spread(value: object, count: int = 20_000) -> np.ndarray:
    """Per lane, also where all lanes are the same."""
    array = to_numpy(value).astype(np.float64)
    return np.broadcast_to(array, (count, *array.shape[1:]))


def is_valid(points: VisiblePoints, count: int = 20_000) -> np.ndarray:
    return spread(points.valid, count).astype(bool)


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
    points = find_visible_points(loaded, sampler, ray, active=active)
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


class OnlyOnes:
    """A sampler whose numbers are one, as a few of ``multijitter`` are."""

    def next_1d(self, active: mi.Bool) -> mi.Float:
        return dr.select(active, mi.Float(1), 1)

    def next_2d(self, active: mi.Bool) -> mi.Point2f:
        return mi.Point2f(self.next_1d(active), 1)


@pytest.mark.parametrize("back", [None, False])
@pytest.mark.parametrize("surface", [diffuse(0.5), {"type": "plastic"}])
def test_a_random_number_may_be_one(surface, back):
    scene = mi.load_dict(
        {"type": "scene", "floor": floor(surface), "lamp": lamp((0, 0, 3), (0, 0, 0), 1, 1, 1, 1)}
    )
    ray = mi.Ray3f(mi.Point3f(0, -1, dr.full(mi.Float, 1, 4)), mi.Vector3f(0, 0.6, -0.8))
    points, _ = follow(scene, OnlyOnes(), ray, back=back)
    for values in (points.throughput, points.emission):
        assert np.isfinite(values.numpy()).all()
    assert points.valid.numpy().all() or (surface["type"] == "plastic" and back is None)


@pytest.mark.parametrize("kind", ["dielectric", "thindielectric"])
def test_both_sides_of_glass_can_be_followed(kind):
    """A pane before a lamp: both weights are Fresnel's, and each walk is the same as the other."""
    glass = GLASS | {"type": kind}
    lamps = {
        "behind": lamp((0, 0, -3), (0, 0, 0), 40, 1, 2, 3),
        "before": lamp((0, 0, 3), (0, 0, 0), 40, 4, 5, 6),
    }
    scene = {"pane": floor(glass, size=40)} | lamps
    through = walk(scene, (0, 0, 1), (0.8, 0, 0), count=100, back=False)
    back = walk(scene, (0, 0, 1), (0.8, 0, 0), count=100, back=True)
    r = float(mi.fresnel(mi.Float(1 / math.hypot(1, 0.8)), mi.Float(1.5))[0][0])
    r = 2 * r / (1 + r) if kind == "thindielectric" else r
    np.testing.assert_allclose(spread(back.share, 100), r, rtol=1e-4)
    np.testing.assert_allclose(spread(through.share, 100), 1 - r, rtol=1e-4)
    np.testing.assert_allclose(spread(back.emission, 100), [[4 * r, 5 * r, 6 * r]] * 100, rtol=1e-4)
    index = 1.5**2 if kind == "dielectric" else 1  # radiance in glass
    expected = (1 - r) * np.array([1, 2, 3]) / index
    np.testing.assert_allclose(spread(through.emission, 100), [expected] * 100, rtol=1e-4)


def test_without_glass_one_walk_is_all():
    scene = {"floor": lamp((0, 0, 0), (0, 0, 1), 6, 1, 2, 3) | {"bsdf": diffuse(0.5)}}
    through = walk(scene, (0, -1, 1), (0.5, 0.2, 0), back=False)
    assert is_valid(through).all() and (spread(through.share) == 1).all()
    np.testing.assert_allclose(spread(through.emission), [[1, 2, 3]] * 20_000, rtol=1e-5)
    back = walk(scene, (0, -1, 1), (0.5, 0.2, 0), back=True)
    assert not is_valid(back).any() and not spread(back.share).any()
    assert not spread(back.emission).any()


def test_total_reflection_is_a_single_side():
    """From within a block of glass, at a slant, the surface is a mirror."""
    scene = {"surface": floor(GLASS, z=0, size=40), "ground": floor(diffuse(0.5), z=-4, size=40)}
    through = walk(scene, (0, 0, -1), (1.5, 0, 0), back=False)
    assert is_valid(through).all() and (spread(through.share) == 1).all()
    assert (spread(through.p)[:, 2] < -3.9).all()
    back = walk(scene, (0, 0, -1), (1.5, 0, 0), back=True)
    assert not is_valid(back).any() and not spread(back.share).any()


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


LAYERED = {
    "plastic": {"type": "plastic", "diffuse_reflectance": rgb(0.6, 0.4, 0.2), "int_ior": 1.9},
    "dark plastic": {"type": "plastic", "diffuse_reflectance": rgb(0.01), "int_ior": 1.9},
    "black plastic": {"type": "plastic", "diffuse_reflectance": rgb(0), "int_ior": 1.9},
    "plastic without gloss": {
        "type": "plastic",
        "diffuse_reflectance": rgb(0.6, 0.4, 0.2),
        "specular_reflectance": rgb(0),
    },
    "roughplastic": {
        "type": "roughplastic",
        "diffuse_reflectance": rgb(0.6, 0.4, 0.2),
        "alpha": 0.2,
    },
    "blend": {
        "type": "blendbsdf",
        "weight": 0.3,
        "a": diffuse(0.6, 0.4, 0.2),
        "b": {"type": "roughconductor", "material": "Al", "alpha": 0.2},
    },
    "mask": {"type": "mask", "opacity": 0.6, "m": diffuse(0.6, 0.4, 0.2)},
}


@pytest.mark.parametrize("ways", [(None,), (False, True)], ids=["one at random", "both"])
@pytest.mark.parametrize("kind", LAYERED)
def test_layered_materials_are_split_without_bias(kind, ways):
    """Under a uniform sky and with E given, the mean radiance is known.

    It is ρ_d(wo) E/π and the albedo of all other lobes times the sky.
    """
    count, sky, e = 400_000, np.array([1.0, 2.0, 4.0]), np.array([30.0, 20.0, 5.0])
    scene = {
        "sheet": floor(LAYERED[kind], size=4),
        "sky": {"type": "constant", "radiance": rgb(*sky)},
    }
    found = [
        walk(scene, (0, -1.5, 1), (0, 0, 0), count=count, seed=seed, back=back)
        for seed, back in enumerate(ways)
    ]
    radiance = sum(spread(each.radiance(mi.Color3f(*e.tolist())), count) for each in found)
    if len(ways) == 2:
        assert sum(spread(each.share, count).mean() for each in found) == pytest.approx(1, abs=2e-3)
        assert is_valid(found[0], count).all() and not is_valid(found[1], count).any()
    mean, error = radiance.mean(0), radiance.std(0) / math.sqrt(count)

    bsdf = mi.load_dict(LAYERED[kind])
    wi = np.array([0, -1.5, 1]) / math.hypot(1.5, 1)
    si = interaction(np.tile(wi, (count, 1)))
    only_diffuse = mi.BSDFContext()
    only_diffuse.type_mask = int(mi.BSDFFlags.Diffuse)
    straight_up = mi.Vector3f(0, 0, dr.ones(mi.Float, count))
    lobe = to_numpy(bsdf.eval(only_diffuse, si, straight_up))[0]
    rng = np.random.default_rng(3)
    u1 = from_numpy(mi.Float, rng.random(count))
    u2 = from_numpy(mi.Point2f, rng.random((count, 2)))
    _, weight = bsdf.sample(specular_context(), si, u1, u2)
    glossy = spread(weight, count)
    expected = lobe * e + glossy.mean(0) * sky
    error = np.hypot(error, glossy.std(0) / math.sqrt(count) * sky)
    assert np.abs(mean - expected).max() < 0.02 * expected.max()
    assert (np.abs(mean - expected) / np.maximum(error, 1e-5)).max() < 4.5


def test_both_parts_of_plastic_are_followed():
    scene = {"floor": floor(LAYERED["plastic"], size=4), "box": room(diffuse(0.5), (5, 5, 5))}
    points = walk(scene, (0, -1.5, 1), (0, 0, 0))
    depth = spread(points.depth)
    assert is_valid(points).all() and set(np.unique(depth)) == {0, 1}
    # The choice is by what the parts reflect: neither is rare, neither has a large weight.
    assert 0.05 < (depth == 1).mean() < 0.6
    assert spread(points.throughput).max() < 4


# --- emission ---------------------------------------------------------------------------------


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

"""Samples of the lit surfaces: where they lie, and that dim regions get their share."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.core.errors import UserError
from gpf.core.structs import Photons, VisiblePoints, concatenate, from_numpy, take
from gpf.photons.tracing import PathSettings, record_photons
from gpf.scene.bounds import scene_bounds
from gpf.training.surface_points import Places, sample_surface_points


def lit_floor(looks_down: bool = True) -> mi.Scene:
    """A floor of 4 by 2 with a small lamp close above its right end."""
    t = mi.ScalarTransform4f
    return mi.load_dict(
        {
            "type": "scene",
            "floor": {
                "type": "rectangle",
                "to_world": t().scale([2, 1, 1]),
                "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.25}},
            },
            "lamp": {
                "type": "rectangle",
                "to_world": t()
                .translate([1.2, 0, 0.5])
                .scale(0.1)
                .rotate([1, 0, 0], 180 if looks_down else 0),
                "bsdf": {"type": "conductor"},
                "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [5, 4, 3]}},
            },
        }
    )


def sample(count: int, paths: int, radius: float, looks_down: bool = True, **sets):
    scene = lit_floor(looks_down)
    photons = record_photons(scene, PathSettings(paths), seed=3)
    return sample_surface_points(
        Places(photons, **sets), count, radius, scene_bounds(scene), seed=3
    )


def seen_at(height: float, count: int) -> VisiblePoints:
    """Visible points all over a plane of the floor's size, at a height."""
    rng = np.random.default_rng(1)
    x, y = rng.uniform([[-2], [-1]], [[2], [1]], (2, count))
    places = np.stack([x, y, np.full(count, height)], axis=1)
    return VisiblePoints(
        p=from_numpy(mi.Point3f, places),
        n=mi.Normal3f(0, 0, dr.full(mi.Float, 1, count)),
        reflectance=mi.Color3f(0.5),
        throughput=mi.Color3f(1),
        emission=mi.Color3f(0),
        depth=mi.UInt32(0),
        valid=dr.full(mi.Bool, True, count),
    )


def test_surface_points_lie_on_the_lit_surface_and_are_spread():
    points = sample(3000, paths=20_000, radius=0.05)
    x, y, z = np.array(points.p)
    assert dr.width(points.p) == 3000 and np.array(points.valid).all()
    assert np.abs(z).max() < 1e-4
    np.testing.assert_allclose(np.array(points.n), np.tile([[0], [0], [1]], 3000), atol=1e-5)
    # Photons alone would put some 70% of the points into the disc below the lamp; evenly spread
    # ones 10%. Half of each:
    below = np.mean(np.hypot(x - 1.2, y) < 0.5)
    assert 0.25 < below < 0.6
    left = np.mean(x < 0)
    assert left > 0.1  # half of the floor gets next to no light, but its points


def test_what_is_seen_in_the_dark_has_its_share():
    points = sample(3000, paths=20_000, radius=0.1, seen=seen_at(-0.5, 5000))
    dark = np.array(points.p.z) < -0.25
    # All of the second half but what is on the floor, which is as large.
    assert 0.2 < dark.mean() < 0.3
    assert np.std(np.array(points.p.x)[dark]) > 1.0  # 4 / √12 = 1.15, where it is uniform
    assert np.mean(np.array(points.p.x)[dark] < 0) == pytest.approx(0.5, abs=0.08)


def test_a_tenth_lies_beyond():
    sets = {"seen": seen_at(-0.5, 5000), "beyond": seen_at(0.25, 1000)}
    points = sample(3000, paths=20_000, radius=0.1, **sets)
    assert np.count_nonzero(np.array(points.p.z) > 0.2) == 300
    sets["beyond"] = take(sets["beyond"], mi.UInt32())
    points = sample(3000, paths=20_000, radius=0.1, **sets)
    assert dr.width(points.p) == 3000
    sets["beyond"] = seen_at(0.25, 70)
    points = sample(3000, paths=20_000, radius=0.1, **sets)
    assert np.count_nonzero(np.array(points.p.z) > 0.2) == 70
    assert dr.width(points.p) == 3000


def test_beyond_costs_no_more_than_its_share():
    """Where ten times as many photons arrive, there are a tenth as many points."""
    sets = {"seen": seen_at(-0.5, 5000), "beyond": seen_at(0.25, 1000)}
    floor, above = seen_at(0.0, 2000), seen_at(0.25, 20_000)
    below = seen_at(-0.5, 2000)
    p = concatenate([floor.p, below.p, above.p])
    n = concatenate([floor.n, below.n, above.n])
    every = dr.width(p)
    power = mi.Color3f(dr.full(mi.Float, 1, every))
    arrivals = Photons(p=p, n=n, power=power, depth=dr.zeros(mi.UInt32, every))
    points = sample(3000, paths=20_000, radius=0.1, arrivals=arrivals, **sets)
    # A bit more than of the floor's points, most of which lie below its lamp and not at the border.
    assert 25 < np.count_nonzero(np.array(points.p.z) > 0.2) < 45
    assert np.count_nonzero(np.array(points.p.z) < 0.2) == 2700


@pytest.mark.parametrize("beyond", [0, 40])
def test_a_point_is_chosen_once(beyond):
    for seen in (0, 300, 301, 302):
        sets = {"seen": seen_at(0.0, seen)} if seen else {}
        sets |= {"beyond": seen_at(-0.5, beyond)} if beyond else {}
        points = sample(100_000, paths=1000, radius=0.1, **sets)
        places = np.unique(np.array(points.p), axis=1)
        assert places.shape[1] == dr.width(points.p) > 500 + seen


def test_no_more_surface_points_than_photons():
    points = sample(100_000, paths=100, radius=0.1)
    assert 50 < dr.width(points.p) <= 100
    points = sample(7, paths=100, radius=0.1)
    assert dr.width(points.p) == 7


def test_a_lamp_that_shines_elsewhere_is_said_in_words():
    with pytest.raises(UserError, match="no photon reached a diffuse surface. Check where the emi"):
        sample(10, paths=100, radius=0.1, looks_down=False)

"""Surfaces that divide a camera walk: one way at random, or both."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.camera.visible_points import follow
from gpf.core.structs import from_numpy, to_numpy
from gpf.scene.materials import specular_context
from tests.camera.walks import GLASS, is_valid, spread, walk
from tests.furnace import diffuse, floor, interaction, lamp, rgb, room


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
    points, _, _ = follow(scene, OnlyOnes(), ray, back=back)
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

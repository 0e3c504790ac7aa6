"""Fixed points: what lamps bring them by samples is what photons bring, whatever the surface."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.camera.next_event import samples_every_emitter
from gpf.core.random import random_start, spread_sample
from gpf.core.structs import VisiblePoints, from_numpy, take, to_numpy
from gpf.scene.lamps import Lamps
from gpf.scene.light_groups import emitter_names
from gpf.sppm.fixed_points import FixedPoints
from gpf.sppm.passes import PassSettings, PhotonPasses
from stages.references.view_samples import fixed_points
from tests.furnace import Scene, bitmap, camera, diffuse, floor, lamp, point_light, rectangle, rgb

CLOTH = {"type": "mask", "opacity": 0.75, "bsdf": {"type": "diffuse"}}
SKY = {"type": "constant", "radiance": rgb(1, 2, 4)}


def points_at(p: Any, n: Any) -> VisiblePoints:
    points = dr.zeros(VisiblePoints, len(p))
    points.p, points.n = (
        from_numpy(mi.Point3f, np.asarray(p)),
        from_numpy(mi.Normal3f, np.asarray(n)),
    )
    points.valid = dr.full(mi.Bool, True, len(p))
    return points


def direct(scene: mi.Scene, points: VisiblePoints, samples: int = 1) -> np.ndarray:
    fixed, start = FixedPoints(scene, points), random_start(7, dr.width(points.p))
    found = [
        to_numpy(fixed.direct_irradiance(spread_sample(start, t))) for t in range(1, samples + 1)
    ]
    return np.mean(found, axis=0)


def test_sums_of_samples_are_those_of_single_ones():
    """With other random numbers and a weight, too. A point lamp is never near."""
    light = point_light((0, 0, 2), 3, 2, 1), point_light((1, 0, 2), 1, 2, 3)
    scene = mi.load_dict(
        {"type": "scene", "floor": floor(diffuse(0.5)), "a": light[0], "b": light[1]}
    )
    fixed = FixedPoints(scene, points_at([(0.1, 0, 0), (1, 0.5, 0)], [(0, 0, 1)] * 2))
    start = random_start(7, 2)

    def warp(sample: mi.Point2f) -> tuple[mi.Point2f, mi.Float]:
        return mi.Point2f(sample.y, sample.x), 2 * sample.x

    single = []
    for t in range(3, 8):
        sample, weight = warp(spread_sample(start, t))
        single.append(to_numpy(fixed.direct_irradiance(sample) * weight))
    total, squares = (to_numpy(v) for v in fixed.direct_sums(start, 3, 5, warp=warp))
    np.testing.assert_allclose(total, np.sum(single, axis=0), rtol=1e-5)
    np.testing.assert_allclose(squares, np.square(single).sum(axis=0), rtol=1e-5)


@pytest.mark.parametrize("height", [0.001, 0.1, 0.5, 5.0])
@pytest.mark.parametrize("cloth", [False, True])
@pytest.mark.parametrize("alone", [False, True])
def test_rays_share_the_light_of_near_lamps(height, cloth, alone):
    """A square lamp of 2 m above a point, seen through holes in cloth or not, alone or beside one
    that it hides: its form factor is known, and no sample is much brighter than the lamp all
    around."""
    scene = mi.load_dict(
        {
            "type": "scene",
            "far": lamp((9, 0, 50), (9, 0, 0), 0.1, 100, 100, 100),
            "lamp": lamp((0, 0, height), (0, 0, 0), 2, 3, 2, 1),
        }
        | ({"cloth": rectangle((0, 0, height / 2), (0, 0, 9), 9, 9, CLOTH)} if cloth else {})
    )
    count, samples = 4096, 64
    fixed = FixedPoints(scene, points_at([(0, 0, 0)] * count, [(0, 0, 1)] * count))
    lamps = Lamps(scene, [emitter_names(scene).index("lamp")] if alone else None)
    total, squares = fixed.direct_sums(random_start(3, count), 1, samples, lamps)
    found = to_numpy(total).mean(axis=0) / samples
    slope = 1 / math.hypot(1, height)
    factor = 4 / math.pi * slope * math.atan(slope)
    expected = (0.25 if cloth else 1) * math.pi * factor * np.array([3, 2, 1])
    np.testing.assert_allclose(found, expected, rtol=0.01)
    assert to_numpy(squares).max() < samples * (20 * math.pi * 3) ** 2


def test_a_sky_keeps_its_light_beside_a_sun():
    """Samples seldom go to the dim part of such a sky, although a lamp can be near."""
    sky = np.ones((32, 64, 3), np.float32)
    sky[8, 16] = 2e5
    scene = mi.load_dict(
        {
            "type": "scene",
            "sky": {"type": "envmap", "bitmap": mi.Bitmap(sky)},
            "lamp": lamp((9, 0, 50), (9, 0, 0), 0.1, 1),
        }
    )
    count, samples = 1 << 16, 16
    fixed = FixedPoints(scene, points_at([(0, 0, 0)] * count, [(0, 0, 1)] * count))
    start = random_start(3, count)
    single = [
        to_numpy(fixed.direct_irradiance(spread_sample(start, t))) for t in range(1, samples + 1)
    ]
    expected = np.mean(single, axis=(0, 1), dtype=np.float64)
    found = (
        to_numpy(fixed.direct_sums(start, 1, samples)[0]).mean(axis=0, dtype=np.float64) / samples
    )
    np.testing.assert_allclose(found, expected, rtol=1e-3)


def test_a_point_light():
    """I cos θ / d² on the side of the normal, nothing on the other nor in the shadow."""
    scene = mi.load_dict(
        {
            "type": "scene",
            "floor": floor(diffuse(0.5)),
            "light": point_light((0, 0, 2), 3, 2, 1),
            "screen": rectangle((0.5, 0, 1), (0.5, 0, 2), 0.1, 0.1, {"type": "diffuse"}),
        }
    )
    up = (0, 0, 1)
    found = direct(scene, points_at([(0, 0, 0), (1, 0, 0), (-1, 0, 0)], [up, up, (0, 0, -1)]))
    np.testing.assert_allclose(found, [[0.75, 0.5, 0.25], [0] * 3, [0] * 3], atol=1e-6)


def test_the_sky():
    """π L on average under a uniform sky, whatever the normal; with no surface there at all."""
    scene = mi.load_dict({"type": "scene", "sky": SKY})
    normal = np.array([0.3, -0.4, 0.5]) / np.sqrt(0.5)
    found = direct(scene, points_at(np.zeros((100_000, 3)), np.tile(normal, (100_000, 1))))
    np.testing.assert_allclose(found.mean(0), np.pi * np.array([1, 2, 4]), rtol=0.02)


BUMPS = np.random.default_rng(2).uniform(0.3, 0.7, (4, 4, 3)) * [1, 1, 0] + [0, 0, 0.9]
SURFACES: dict[str, Scene] = {
    "diffuse": diffuse(0.5),
    "plastic": {"type": "plastic", "diffuse_reflectance": rgb(0.3, 0.5, 0.7)},
    "rough plastic": {"type": "roughplastic", "alpha": 0.3, "nonlinear": True},
    "blend": {"type": "blendbsdf", "weight": 0.3, "a": diffuse(0.7), "b": {"type": "plastic"}},
    "two sides": {"type": "twosided", "a": diffuse(0.4)},
    "bumps": {"type": "normalmap", "normalmap": bitmap(BUMPS), "b": diffuse(0.5)},
}


def test_samples_bring_what_photons_bring():
    """On layered and bumped surfaces too, from a lamp low above them: six tiles of a floor."""
    corners = {kind: (k % 3 - 1.5, k // 3 - 1.0) for k, kind in enumerate(SURFACES)}
    tiles = {
        kind: {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f().translate([x + 0.5, y + 0.5, 0]).scale(0.5),
            "bsdf": SURFACES[kind],
        }
        for kind, (x, y) in corners.items()
    }
    p, photons, samples = both_ways(tiles)
    for kind, corner in corners.items():
        # Away from other tiles, whose photons are weighted otherwise.
        here = (np.abs(p[:, :2] - corner - 0.5) < 0.4).all(1)
        assert here.sum() > 100
        np.testing.assert_allclose(
            samples[here].mean(0), photons[here].mean(0), rtol=0.02, err_msg=kind
        )


@pytest.mark.slow
def test_samples_bring_what_photons_bring_to_smooth_normals(tmp_path):
    vertices = np.array([[0, 0, 0.4], [1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]])
    normals = vertices * [0.7, 0.7, 0] + [0, 0, 1]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    mesh = mi.Mesh("dome", 5, 4, has_vertex_normals=True)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = np.float32(vertices).ravel()
    parameters["vertex_normals"] = np.float32(normals).ravel()
    parameters["faces"] = np.uint32([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 1]]).ravel()
    parameters.update()
    mesh.write_ply(str(tmp_path / "dome.ply"))
    dome = {"type": "ply", "filename": str(tmp_path / "dome.ply"), "b": diffuse(0.5)}
    # With four times this radius, photons are 4 % brighter where light falls off along the edge.
    _, photons, samples = both_ways({"dome": dome}, radius=0.02, paths=1_200_000, samples=120)
    for block in np.array_split(np.arange(len(photons)), 12):
        np.testing.assert_allclose(samples[block].mean(0), photons[block].mean(0), rtol=0.03)


def both_ways(
    shapes: dict[str, Scene], radius: float = 0.08, paths: int = 160_000, samples: int = 40
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points of a small picture, and their irradiance by photons and by samples, (N, 3) each.

    A mean over some 160 pixels has a standard error of 0.5 %.
    """
    light = lamp((1.6, 0.3, 0.8), (0, 0, 0), 0.4, 20, 30, 40)
    scene = mi.load_dict({"type": "scene", **shapes, "lamp": light})
    sensor = mi.load_dict(camera((0, -1.5, 3), (0, 0, 0), 40, (48, 48)))
    settings = PassSettings(initial_radius=radius, max_depth=2)
    points = fixed_points(scene, sensor, "view", settings, 1)
    fixed = FixedPoints(scene, take(points, dr.compress(points.valid)))
    start, means = random_start(9, dr.width(fixed.points.p)), []
    # Paths of two edges have no indirect light: beside samples of the emitters, photons bring
    # nothing.
    for direct, count, emitted in (("photons", 10, paths), ("emitters", samples, 1000)):
        changes = {"direct": direct, "photons_per_pass": emitted}
        passes = PhotonPasses(scene, settings.model_copy(update=changes), 5)
        singles = [passes.trace(t).all_irradiance(fixed, start, t)[0] for t in range(1, count + 1)]
        means.append(np.mean([to_numpy(e) for e in singles], axis=0))
    assert means[1].mean() > 0.1
    return to_numpy(fixed.points.p), *means


def test_an_emitter_that_cannot_be_sampled_leaves_direct_light_to_photons():
    beam = lamp((0, 0, 1), (0, 0, 0), 0.5, 1, 1, 1)
    ordinary = mi.load_dict({"type": "scene", "lamp": beam, "floor": floor(diffuse(0.5))})
    beam["emitter"] = {"type": "directionalarea", "radiance": rgb(3, 2, 1)}
    laser = mi.load_dict({"type": "scene", "lamp": beam, "floor": floor(diffuse(0.5))})
    assert samples_every_emitter(ordinary) and not samples_every_emitter(laser)
    settings = PassSettings(photons_per_pass=1000, direct="emitters")
    assert PhotonPasses(ordinary, settings, 1).settings.direct == "emitters"
    assert PhotonPasses(laser, settings, 1).settings.direct == "photons"

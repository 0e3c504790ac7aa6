"""Light of diffuse surfaces by rays that end in a field: all of it, once, and none from nearby."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.core.structs import Photons, VisiblePoints, from_numpy
from gpf.field.field import GaussianPhotonField
from gpf.field.gaussians import Gaussians
from gpf.field.settings import FieldSettings
from gpf.sppm.fixed_points import FixedPoints
from gpf.sppm.passes import PassSettings
from gpf.training.gathered_light import GatheredLight
from gpf.training.streaming import PhotonStream
from stages.config.training import FieldTrainingSettings
from stages.training.recipe import Recipe
from tests.furnace import diffuse, floor

BOUNDS = mi.ScalarPoint3f(-1, -1, -1), mi.ScalarPoint3f(1, 1, 1)
COUNT = 500


def field_of(value: float, p: np.ndarray, n: np.ndarray, radius: float = 0.1):
    """A field with the same irradiance everywhere around some points."""
    count = len(p)
    gaussians = Gaussians(
        means=from_numpy(mi.Point3f, p),
        log_scales=dr.full(mi.Vector3f, np.log(radius), count),
        quats=dr.full(mi.Quaternion4f, 1, count),
        irradiance=dr.full(mi.Color3f, value, count),
        normals=from_numpy(mi.Normal3f, n),
    )
    return GaussianPhotonField(gaussians, FieldSettings(search_radius=radius), BOUNDS)


def sheet(z: float, up: float, count: int = 4000) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(2)
    p = np.column_stack([rng.uniform(-1, 1, (count, 2)), np.full(count, z)])
    return p, np.tile([0.0, 0.0, up], (count, 1))


def points_at(p: np.ndarray, n: np.ndarray) -> VisiblePoints:
    points = dr.zeros(VisiblePoints, len(p))
    points.p, points.n = from_numpy(mi.Point3f, p), from_numpy(mi.Normal3f, n)
    points.valid, points.reflectance = dr.full(mi.Bool, True, len(p)), mi.Color3f(0.5)
    return points


def gathered(shapes: dict, field: GaussianPhotonField, points: VisiblePoints, rays: int = 64):
    scene = mi.load_dict({"type": "scene"} | shapes)
    light = GatheredLight(FixedPoints(scene, points), field, seed=5)
    light.per_pass = rays
    light.sample(1)
    return (light.mean(0) + light.mean(1)) / 2


def ceiling(z: float, bsdf: dict) -> dict:
    turned = mi.ScalarTransform4f().translate([0, 0, z]).rotate([1, 0, 0], 180)
    return {"type": "rectangle", "to_world": turned, "bsdf": bsdf}


def at_centre(count: int = COUNT) -> VisiblePoints:
    return points_at(np.zeros((count, 3)), np.tile([0.0, 0.0, 1.0], (count, 1)))


def form_factor(half: float, height: float) -> float:
    """Of a square above a point, parallel to it (Howell, C-catalogue, B-3): four corners."""
    x = half / height
    root = np.sqrt(1 + x * x)
    return 4 * (2 * x / root * np.arctan(x / root)) / (2 * np.pi)


def test_a_ceiling_sends_what_the_field_says_that_arrives_there():
    """E = ρ E_f F, where F is the form factor."""
    shapes = {"floor": floor(diffuse(0.3)), "ceiling": ceiling(0.6, diffuse(0.8))}
    found = gathered(shapes, field_of(2.0, *sheet(0.6, -1)), at_centre())
    assert found.mean() == pytest.approx(0.8 * 2 * form_factor(1, 0.6), rel=5e-3)


def test_rays_go_straight_through_what_lets_light_pass():
    """Three quarters of the light come from a curtain, which itself is half as bright."""
    curtain = {"type": "mask", "opacity": 0.25, "bsdf": {"type": "twosided", "d": diffuse(0.4)}}
    shapes = {
        "floor": floor(diffuse(0.3)),
        "ceiling": ceiling(0.6, diffuse(0.8)),
        "curtain": ceiling(0.3, curtain),
    }
    p, n = (np.concatenate(parts) for parts in zip(sheet(0.6, -1), sheet(0.3, -1), strict=True))
    found = gathered(shapes, field_of(2.0, p, n), at_centre())
    far, near = (form_factor(1, height) for height in (0.6, 0.3))
    # Beside the curtain the ceiling is not seen at all: both are as wide.
    expected = 2 * (0.75 * 0.8 * far + 0.25 * 0.4 * near)
    assert found.mean() == pytest.approx(expected, rel=1e-2)


def test_in_a_narrow_gap_rays_go_on_until_the_field_tells_what_it_knows():
    """A board a centimetre above a floor: the field is bright on the board, whose underside is not
    lit by anything."""
    shapes = {"floor": floor(diffuse(0.5)), "board": ceiling(0.01, diffuse(0.5))}
    p, n = (np.concatenate(parts) for parts in zip(sheet(0.01, -1), sheet(0, 1), strict=True))
    # Without these rays .5; a few leave the gap's neighbourhood at once.
    found = gathered(shapes, field_of(1.0, p, n, radius=0.4), at_centre())
    assert found.mean() < 0.06


def on_walls(count: int) -> VisiblePoints:
    """Points on the inner sides of the cube from -1 to 1."""
    rng = np.random.default_rng(1)
    axis, side = rng.integers(0, 3, count), rng.choice([-1.0, 1.0], count)
    p, n = rng.uniform(-1, 1, (count, 3)), np.zeros((count, 3))
    rows = np.arange(count)
    p[rows, axis], n[rows, axis] = side, -side
    return points_at(p, n)


def test_with_gathered_light_points_have_as_much_as_with_photons():
    """In a closed room with a lamp and a mirror, nothing is missing, and nothing counts twice."""
    lamp = mi.ScalarTransform4f().translate([0, 0, 0.8]).scale(0.3).rotate([1, 0, 0], 180)
    mirror = mi.ScalarTransform4f().translate([0, 0.9, 0]).scale(0.4).rotate([1, 0, 0], 90)
    scene = mi.load_dict(
        {
            "type": "scene",
            "room": {"type": "cube", "flip_normals": True, "bsdf": diffuse(0.6)},
            "lamp": {"type": "rectangle", "to_world": lamp, "emitter": {"type": "area"}},
            "mirror": {
                "type": "rectangle",
                "to_world": mirror,
                "bsdf": {"type": "twosided", "bsdf": {"type": "conductor"}},
            },
        }
    )
    settings = PassSettings(photons_per_pass=50_000, initial_radius=0.2)
    stream = PhotonStream(scene, settings, {"view": on_walls(8000)}, seed=3)
    stream.advance(12)
    halves = stream.halves()
    before = stream.mean(halves)
    recipe = Recipe(train=FieldTrainingSettings(steps=100))
    trainer = recipe.fit_stream(stream, halves, dr.zeros(Photons, 0), BOUNDS)
    stream.light_by(trainer.run())
    after = stream.mean(stream.halves())
    assert stream.gathered is not None and stream.gathered.samples == GatheredLight.LEAST
    indirect = (before.irradiance - before.direct).mean()
    assert (after.irradiance - after.direct).mean() == pytest.approx(indirect, rel=0.015)
    # Interrupted before its first rays, a stream takes them when it has to.
    stream.gathered = GatheredLight(stream.gathered.points, stream.gathered.field, seed=7)
    again = stream.mean(stream.halves())
    assert stream.gathered.samples == GatheredLight.LEAST
    assert again.irradiance.mean() == pytest.approx(after.irradiance.mean(), rel=0.01)
    # What the mirror sends stays with the photons.
    alone = after.irradiance.mean() - after.direct.mean()
    alone -= np.mean([stream.gathered.mean(half).mean() for half in range(2)])
    assert 0.005 * indirect < alone < 0.3 * indirect

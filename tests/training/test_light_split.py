"""The light of groups of emitters, kept apart in a stream and in a field."""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.core.structs import SurfacePoints, from_numpy, to_numpy
from gpf.field.field import GaussianPhotonField
from gpf.field.settings import FieldSettings
from gpf.photons.emission import emit_light
from gpf.scene.light_groups import LightGroups, emitter_names
from gpf.sppm.passes import PassSettings
from gpf.training.light_split import split_light
from gpf.training.streaming import PhotonStream
from tests.furnace import diffuse, floor, lamp, two_sided
from tests.plain_field import flat_gaussians, to_device
from tests.sppm.test_fixed_points import points_at

BALL = {"type": "sphere", "center": [0, 0, 0.6], "radius": 0.4, "bsdf": {"type": "dielectric"}}


COUNT = 8000


def make_scene(left=1.0, right=1.0):
    """Two lamps over a floor with a wall and a glass ball."""
    lamps = {}
    if left:
        lamps["left"] = lamp((-1, 0, 2), (-0.5, 0, 0), 0.4, 10 * left, 8 * left, 2 * left)
    if right:
        lamps["right"] = lamp((1.5, 0.5, 2), (0.5, 0, 0), 0.4, 2 * right, 6 * right, 12 * right)
    wall = {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f()
        .look_at([0, 2, 1], [0, 0, 1], [0, 0, 1])
        .scale([3, 1, 1]),
        "bsdf": two_sided(0.7),
    }
    return mi.load_dict(
        {"type": "scene", "floor": floor(diffuse(0.6)), "wall": wall, "ball": BALL, **lamps}
    )


def stream_of(scene, direct, groups=None, passes=12):
    rng = np.random.default_rng(1)
    p = np.hstack([rng.uniform(-1.5, 1.5, (COUNT, 2)), np.zeros((COUNT, 1))])
    points = points_at(p, np.tile([0.0, 0, 1], (COUNT, 1)))
    settings = PassSettings(photons_per_pass=60_000, initial_radius=0.15, direct=direct)
    stream = PhotonStream(scene, settings, {"view": points}, 5, emit_light, None, groups)
    stream.advance(passes)
    halves = stream.halves()
    return stream, stream.mean(halves).irradiance


@pytest.mark.parametrize("direct", ["photons", "emitters"])
def test_groups_add_up_and_each_is_the_light_of_its_lamps(direct):
    scene = make_scene()
    groups = LightGroups.each(scene)
    stream, whole = stream_of(scene, direct, groups)
    _, same = stream_of(scene, direct)
    # Photons of two groups in one place have cells of their own, whose means are others.
    assert np.abs(whole - same).mean() < 2e-3 * same.mean()
    parts = stream.by_group()
    assert parts.shape == (2, COUNT, 3)
    np.testing.assert_allclose(parts.sum(0).mean(0), whole.mean(0), rtol=0.02)
    alone = {"left": make_scene(right=0), "right": make_scene(left=0)}
    for number, name in enumerate(groups.names):
        _, expected = stream_of(alone[name], direct, passes=24)
        near = np.abs(parts[number] - expected).mean() / expected.mean()
        assert near < 0.12, name
        np.testing.assert_allclose(parts[number].mean(0), expected.mean(0), rtol=0.02)
    assert emitter_names(scene) == list(groups.names)


def random_field(rng, count=400):
    p = np.hstack([rng.uniform(-1, 1, (count, 2)), np.zeros((count, 1))])
    parts = rng.uniform(0.1, 1, (3, count, 3)) * (
        1 + np.sin(3 * p[:, :1] * np.arange(1, 4)[:, None, None])
    )
    g = flat_gaussians(p, parts.sum(0), size=0.08)
    bounds = (mi.ScalarPoint3f(-1, -1, -0.1), mi.ScalarPoint3f(1, 1, 0.1))
    return GaussianPhotonField(to_device(g), FieldSettings(search_radius=0.25), bounds), parts


def answer(field, colours, points):
    """What the field would answer with these colours, (P, 3)."""
    irradiance = from_numpy(mi.Color3f, colours)
    g = replace(field.gaussians, irradiance=irradiance)
    other = GaussianPhotonField(g, field.settings, field.bounds)
    return to_numpy(other.query(points.p, points.n, mi.Bool(True))[0])


def test_the_parts_of_a_field_answer_as_their_groups_do():
    rng = np.random.default_rng(7)
    field, parts = random_field(rng)
    p = np.hstack([rng.uniform(-0.9, 0.9, (6000, 2)), np.zeros((6000, 1))])
    points = SurfacePoints(
        p=from_numpy(mi.Point3f, p),
        n=mi.Normal3f(0, 0, 1) + dr.zeros(mi.Normal3f, 6000),
        target=dr.zeros(mi.Color3f, 6000),
    )
    targets = []
    for part in parts:
        targets.append(answer(field, part, points))
    found = split_light(field, points, np.stack(targets))
    whole = to_numpy(field.gaussians.irradiance)
    np.testing.assert_allclose(found.sum(0), whole, rtol=1e-5)
    for split, target in zip(found, targets, strict=True):
        assert np.abs(answer(field, split, points) - target).mean() < 0.02 * target.mean()


def test_where_no_light_arrives_the_groups_share():
    field, _ = random_field(np.random.default_rng(3))
    points = SurfacePoints(
        p=mi.Point3f(mi.Float([0.0, 0.5]), 0, 0),
        n=mi.Normal3f(0, 0, 1) + dr.zeros(mi.Normal3f, 2),
        target=dr.zeros(mi.Color3f, 2),
    )
    found = split_light(field, points, np.zeros((2, 2, 3)))
    np.testing.assert_allclose(found[0], found[1])
    assert np.isfinite(found).all()

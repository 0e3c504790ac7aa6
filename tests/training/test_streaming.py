"""Streaming supervision: what is learned from is the mean so far, and all turns are taken."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.core.random import pass_seed
from gpf.core.structs import SurfacePoints, VisiblePoints, to_numpy
from gpf.field.field import FieldSettings
from gpf.photons.tracing import PathSettings, record_photons
from gpf.scene.bounds import scene_bounds
from gpf.sppm.density import PhotonDensity, radius_at
from gpf.sppm.passes import PassSettings
from gpf.training.settings import TrainingSettings
from gpf.training.streaming import PhotonStream, StreamSettings, train_on_stream
from gpf.training.targets import Targets
from gpf.training.trainer import Trainer
from tests.furnace import diffuse, floor, point_light
from tests.plain_field import make_field, random_gaussians

SETTINGS = PassSettings(photons_per_pass=4000, initial_radius=0.3, direct="photons")


def supervise(targets: Targets) -> SurfacePoints:
    return targets.supervised_points("views", "irradiance", "relative")


def make_stream(settings: PassSettings = SETTINGS) -> PhotonStream:
    light = point_light((0, 0, 1), 2, 1, 0.5)
    scene = mi.load_dict({"type": "scene", "floor": floor(diffuse(0.5)), "light": light})
    place = np.random.default_rng(1).uniform(-0.5, 0.5, (2, 300)).astype(np.float32)
    points = dr.zeros(VisiblePoints, 300)
    points.p = mi.Point3f(*place, dr.zeros(mi.Float, 300))
    points.n = dr.full(mi.Normal3f, 0, 300)
    points.n.z = dr.full(mi.Float, 1, 300)
    points.valid = dr.full(mi.Bool, True, 300)
    points.reflectance = mi.Color3f(0.5)
    dr.make_opaque(points)
    points.valid &= dr.arange(mi.UInt32, 300) % 3 != 0  # those in between are of no use
    return PhotonStream(scene, settings, {"view": points}, seed=3)


@pytest.mark.parametrize(("passes", "first"), [(250, 8), (20, 8), (5, 8), (1, 1)])
def test_rounds_grow_and_end_with_the_last_pass(passes, first):
    rounds = StreamSettings(passes=passes, first=first).rounds()
    assert rounds[0] == min(first, passes) and rounds[-1] == passes
    assert rounds == sorted(set(rounds))


def test_targets_are_what_all_photons_so_far_say():
    """Gathered one by one from the same photons, with the last pass's radius for all."""
    stream = make_stream()
    stream.advance(3)
    targets, radius = stream.targets(), radius_at(3, 0.3, SETTINGS.alpha)
    p, n = mi.Point3f(targets.position.T), mi.Normal3f(targets.normal.T)
    expected = np.zeros_like(targets.irradiance)
    for t in (1, 2, 3):
        photons = record_photons(stream.scene, PathSettings(4000), seed=pass_seed(3, t, stream=0))
        bounds = scene_bounds(stream.scene)
        density = PhotonDensity(photons, radius, bounds, smooth=True)
        expected += to_numpy(density.irradiance(p, n)) / 3
    difference = targets.irradiance - expected
    assert np.sqrt(np.mean(difference**2)) < 0.02 * expected.mean()
    assert targets.irradiance.mean() == pytest.approx(expected.mean(), rel=2e-3)
    assert targets.direct.max() == 0


def test_independent_passes_have_other_photons_for_the_same_points():
    stream = make_stream()
    stream.advance(2)
    other = stream.independent()
    ours, theirs = stream.targets(), other.targets()
    np.testing.assert_array_equal(ours.position, theirs.position)
    relative = (ours.irradiance - theirs.irradiance) / ours.irradiance.mean()
    assert 0.01 < np.sqrt(np.mean(relative**2)) < 0.5
    assert stream.count == other.count == 2


def test_all_passes_and_steps_are_done():
    stream = make_stream()
    stream.advance(2)
    field = make_field(
        random_gaussians(np.random.default_rng(4), 60), FieldSettings(search_radius=0.5)
    )
    settings = TrainingSettings(steps=20, batch=64, rebuild_every=10, held_out=0.2, seed=0)
    trainer, seen = Trainer(field, supervise(stream.targets()), settings), []
    turns = StreamSettings(passes=12, first=4)
    train_on_stream(trainer, stream, turns, supervise, tick=lambda *turn: seen.append(turn))
    assert stream.count == 12 and trainer.step_count == 20
    assert seen[-1] == (12, 20) and seen == sorted(seen)
    learned = to_numpy(trainer.training.target) * trainer.unit
    known = stream.targets().irradiance
    np.testing.assert_allclose(learned.sum(0) / known.sum(0), 0.8, atol=0.1)


def test_direct_light_may_come_from_samples_of_the_emitters():
    """Of a point light they know all at once: I cos θ / d² at every point, with no photon."""
    stream = make_stream(SETTINGS.model_copy(update={"direct": "emitters"}))
    stream.advance(2)
    targets = stream.targets()
    assert len(targets.source) == 200 and set(targets.source) == {0}
    squared = (targets.position**2).sum(axis=1) + 1
    expected = np.array([2, 1, 0.5]) / squared[:, None] ** 1.5
    np.testing.assert_allclose(targets.direct, expected, rtol=1e-4)
    np.testing.assert_allclose(targets.irradiance, expected, rtol=1e-4)

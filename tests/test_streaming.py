"""Streaming supervision: what is learned from is the mean so far, and all turns are taken."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.field import FieldSettings
from gpf.progressive import PassSettings, PhotonPasses
from gpf.streaming import PhotonStream, StreamSettings, train_on_stream
from gpf.structs import VisiblePoints, to_numpy
from gpf.training import Trainer, TrainingSettings
from tests.furnace import diffuse, floor, point_light
from tests.plain_field import make_field, random_gaussians

SETTINGS = PassSettings(photons_per_pass=4000, initial_radius=0.3)


@pytest.fixture
def stream() -> PhotonStream:
    light = point_light((0, 0, 1), 2, 1, 0.5)
    scene = mi.load_dict({"type": "scene", "floor": floor(diffuse(0.5)), "light": light})
    place = np.random.default_rng(1).uniform(-0.5, 0.5, (2, 300)).astype(np.float32)
    points = dr.zeros(VisiblePoints, 300)
    points.p = mi.Point3f(*place, dr.zeros(mi.Float, 300))
    points.n = dr.full(mi.Normal3f, 0, 300)
    points.n.z = dr.full(mi.Float, 1, 300)
    points.valid = dr.full(mi.Bool, True, 300)
    dr.make_opaque(points)
    return PhotonStream(PhotonPasses(scene, SETTINGS, 3), points, "relative")


@pytest.mark.parametrize(("passes", "first"), [(250, 8), (20, 8), (5, 8), (1, 1)])
def test_rounds_grow_and_end_with_the_last_pass(passes, first):
    rounds = StreamSettings(passes, first).rounds()
    assert rounds[0] == min(first, passes) and rounds[-1] == passes
    assert rounds == sorted(set(rounds))


def test_targets_are_the_mean_so_far(stream):
    stream.advance(3)
    singles = [stream.passes.trace(t).irradiance(stream.points) for t in (1, 2, 3)]
    expected = np.mean([to_numpy(e) for e in singles], axis=0)
    points = stream.supervised_points()
    np.testing.assert_allclose(to_numpy(points.target), expected, rtol=1e-5)
    assert np.mean(points.weight.numpy()) == pytest.approx(1, rel=1e-5)


def test_all_passes_and_steps_are_done(stream):
    stream.advance(2)
    field = make_field(random_gaussians(np.random.default_rng(4), 60), FieldSettings(0.5))
    settings = TrainingSettings(steps=20, batch=64, rebuild_every=10, held_out=0.2)
    trainer, seen = Trainer(field, stream.supervised_points(), settings), []
    train_on_stream(trainer, stream, StreamSettings(12, 4), tick=lambda *turn: seen.append(turn))
    assert stream.count == 12 and trainer.step_count == 20
    assert seen[-1] == (12, 20) and seen == sorted(seen)
    learned = to_numpy(trainer.training.target) * trainer.unit
    known = to_numpy(stream.supervised_points().target)
    np.testing.assert_allclose(learned.sum(0) / known.sum(0), 0.8, atol=0.1)

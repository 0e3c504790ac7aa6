"""Instant-NGP on three glowing panels."""

from collections.abc import Callable
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

from baselines.instant_ngp import baseline
from baselines.instant_ngp.baseline import InstantNgp, PreparedVolume
from baselines.instant_ngp.radiance_volume import VolumeShape
from baselines.neural import fitting
from baselines.neural.hash_encoding import GridShape
from baselines.options import InstantNgpOptions
from baselines.protocol import CannotServe, Task, TrainingView
from gpf.scene.sensors import make_sensor
from gpf.scene.views import View
from metrics.image import psnr

WIDTH, HEIGHT = 24, 20
STEPS = 500
VIEWS = [
    View(name="left", origin=(-2.2, 0.8, 2.6), target=(0, 0, 0), fov=42),
    View(name="right", origin=(2.3, 1.0, 2.4), target=(0, 0, 0), fov=42),
    View(name="high", origin=(0.4, 2.8, 2.2), target=(0, 0, 0), fov=42),
]


def make_scene() -> mi.Scene:
    t = mi.ScalarTransform4f

    def panel(to_world: mi.ScalarTransform4f, radiance: list[float]) -> dict:
        return {
            "type": "rectangle",
            "to_world": to_world,
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": radiance}},
        }

    return mi.load_dict(
        {
            "type": "scene",
            "back": panel(t().translate([0, 0, -1]).scale([1, 0.7, 1]), [0.8, 0.3, 0.1]),
            "floor": panel(t().translate([0, -0.7, 0]).rotate([1, 0, 0], -90), [0.1, 0.25, 0.5]),
            "lamp": panel(t().translate([0.3, -0.1, 0.2]).scale(0.35), [6.0, 5.0, 3.0]),
        }
    )


@pytest.fixture(scope="module")
def pictures() -> tuple[TrainingView, ...]:
    """What the views see, without noise but for that of the edges."""
    scene, integrator = make_scene(), mi.load_dict({"type": "path", "max_depth": 1})
    found = []
    for view in VIEWS:
        sensor = make_sensor(view, WIDTH, HEIGHT)
        image = np.array(mi.render(scene, integrator=integrator, sensor=sensor, spp=64, seed=1))
        found.append(TrainingView(view, {"radiance": image}))
    return tuple(found)


@pytest.fixture
def task(tmp_path: Path, pictures: tuple[TrainingView, ...]) -> Task:
    return Task(
        name="panels",
        scene=make_scene(),
        file=tmp_path / "scene.xml",
        size=(WIDTH, HEIGHT),
        exposure=0.9,
        training=pictures,
        rr_depth=5,
        seed=3,
        state=tmp_path,
    )


@pytest.fixture(autouse=True)
def tiny(monkeypatch: pytest.MonkeyPatch) -> None:
    shape = VolumeShape(GridShape(5, 2, log2_entries=12, coarsest=6, finest=48), (16,), 7, (16,))
    monkeypatch.setattr(baseline, "SHAPE", shape)
    monkeypatch.setattr(baseline, "CELLS", 24)
    monkeypatch.setattr(baseline, "STEPS", 100)
    monkeypatch.setattr(fitting, "CHECKPOINT_STEPS", 10)


def prepare(
    task: Task, steps: int = STEPS, report: Callable[[int, int], None] | None = None
) -> PreparedVolume:
    options = InstantNgpOptions(system="instant_ngp", steps=steps, samples=8192)
    if report is not None:
        task = Task(**(vars(task) | {"report": report}))
    return InstantNgp(options).prepare(task)


def test_training_views_are_reproduced(task: Task):
    prepared = prepare(task, steps=3 * STEPS // 2)
    for seen in task.training:
        image = prepared.render(seen.view, seed=2)
        assert image.shape == (HEIGHT, WIDTH, 3) and image.dtype == np.float32
        assert psnr(image, seen.radiance, task.exposure) > 25, seen.view.name
        lamp = seen.radiance.max(axis=2) > 5.9
        assert lamp.sum() > 3
        # Linear, and far brighter than a display's white.
        np.testing.assert_allclose(image[lamp].mean(0), [6, 5, 3], rtol=0.15)
    assert 0 < prepared.facts["occupied"] < 0.5
    assert 25 < prepared.facts["training_psnr"] < 60
    assert prepared.storage_bytes > 4 * prepared.facts["parameters"] > 4000


def test_a_killed_training_goes_on(task: Task):
    def kill(done: int, total: int) -> None:
        if done == 37:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        prepare(task, 40, kill)
    seen: list[int] = []
    prepare(task, 40, lambda done, total: seen.append(done))
    assert seen == list(range(30, 41))
    dimmer = [TrainingView(v.view, {"radiance": 0.5 * v.radiance}) for v in task.training]
    other = Task(**(vars(task) | {"training": tuple(dimmer)}))
    prepare(other, 2, lambda done, total: seen.append(done))
    assert seen[-3:] == [0, 1, 2]


def test_there_have_to_be_views(task: Task):
    with pytest.raises(CannotServe, match="has no training views"):
        prepare(Task(**(vars(task) | {"training": ()})))

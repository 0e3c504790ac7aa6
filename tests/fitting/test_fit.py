"""A field from a scene in one call, and the estimate of its quality."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

import gpf
from gpf.core.errors import UserError
from gpf.core.images import tone_map
from gpf.field.io import read_field
from gpf.fitting import fit as module
from gpf.fitting.quality import QualityEstimate
from gpf.scene.sensors import make_sensor
from gpf.scene.views import View
from gpf.sppm.passes import PassSettings
from gpf.sppm.reference import ReferenceRenderer

VIEWS = [
    View(name="front", origin=(0, 0, 3.9), target=(0, 0, 0), fov=39.3),
    View(name="left", origin=(-0.5, 0.2, 2.5), target=(0.1, -0.3, 0), fov=45),
]


@pytest.fixture(scope="module")
def scene():
    return mi.load_dict(mi.cornell_box(), optimize=False)


@pytest.fixture(autouse=True)
def small(monkeypatch):
    """A fit of a second."""
    monkeypatch.setattr(module, "STEPS", 40)
    monkeypatch.setattr(module, "FIRST_PASSES", 6)
    monkeypatch.setattr("gpf.training.recipe.MAX_GAUSSIANS", 4000)
    monkeypatch.setattr("gpf.sppm.reference.EQUAL_PATHS", 20_000)


def sensors(rows: int = 32):
    return [make_sensor(view, rows, rows) for view in VIEWS]


def test_a_fit_says_how_far_it_is_and_what_it_made(scene):
    told = []
    field = gpf.fit(scene, sensors(), passes=40, seed=3, callback=told.append)
    assert field.record["passes"] == 40 and field.record["seed"] == 3
    assert [t.passes for t in told] == sorted(t.passes for t in told)
    assert told[-1].passes == told[-1].all_passes == 40 and told[-1].steps == 40
    assert told[-1].psnr == field.record["estimated_psnr"] and told[-1].held_out_error > 0
    shown = [t for t in told if t.field is not None]
    assert len(shown) >= 2 and shown[-1] is told[-1]
    assert 24 < field.record["estimated_psnr"] < 50


def test_with_a_psnr_as_the_goal_there_are_as_many_passes_as_it_needs(scene):
    asked = gpf.fit(scene, sensors(), passes=40, seed=1).record["estimated_psnr"] - 0.3
    record = gpf.fit(scene, sensors(), target_psnr=asked, seed=1).record
    assert record["estimated_psnr"] >= asked and record["passes"] > 6


def test_what_is_out_of_reach_ends_with_a_warning(scene, monkeypatch, caplog):
    monkeypatch.setattr(module, "LEAST_GAIN", 30)
    field = gpf.fit(scene, sensors(), target_psnr=90)
    assert field.record["passes"] < 100 and "do not raise the estimated PSNR" in caplog.text


def test_time_ends_a_fit(scene):
    gpf.fit(scene, sensors(), passes=24)  # compiles the kernels
    record = gpf.fit(scene, sensors(), seconds=8).record
    assert record["passes"] > 24 and 3 < record["seconds"] < 12


def test_interrupted_the_best_field_so_far_is_returned(scene):
    def stop(progress):
        if progress.psnr is not None:
            raise KeyboardInterrupt

    field = gpf.fit(scene, sensors(), target_psnr=90, callback=stop)
    assert field.record["estimated_psnr"] > 20 and dr.width(field.gaussians.means) > 0


def test_before_the_first_field_an_interrupt_ends_the_fit(scene):
    def stop(progress):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        gpf.fit(scene, sensors(), passes=30, callback=stop)


@pytest.mark.parametrize("goal", [{"seconds": 0}, {"passes": -1}, {"target_psnr": 0.0}])
def test_goals_are_above_zero(scene, goal):
    with pytest.raises(UserError, match="Give a number above 0"):
        gpf.fit(scene, sensors(), **goal)


def test_a_scene_without_a_camera_needs_sensors():
    box = {key: value for key, value in mi.cornell_box().items() if key != "sensor"}
    with pytest.raises(UserError, match="has no perspective camera"):
        gpf.fit(mi.load_dict(box, optimize=False), passes=10)


def test_the_estimate_is_the_psnr_against_a_reference(scene):
    """Of an image that is known: SPPM with few passes, at the same pixels."""
    settings = PassSettings(photons_per_pass=20_000, initial_radius=0.05)
    views = sensors(24)
    named = {f"{k}": sensor for k, sensor in enumerate(views)}
    reference = ReferenceRenderer(scene, named, {}, settings, seed=50)
    truth = reference.run(400)
    estimate = QualityEstimate(scene, views, settings, seed=7, pixels=2000, exposure=0.5)
    for _ in range(40):
        estimate.add_pass()
    for level in (0.9, 1.3):
        images = [reference.image(name, truth) for name in named]
        pixels = np.concatenate(
            [image[at[:, 1], at[:, 0]] for image, at in zip(images, estimate._pixels, strict=True)]
        )
        error = np.mean((tone_map(level * pixels, 0.5) - tone_map(pixels, 0.5)) ** 2)
        estimate._render = lambda field, shown=level * pixels: shown
        assert estimate.psnr(None) == pytest.approx(-10 * np.log10(error), abs=0.6)


def test_the_command_writes_a_field_and_a_picture(tmp_path, monkeypatch):
    from gpf.cli import main

    source = tmp_path / "box.xml"
    box = mi.cornell_box()
    box["sensor"]["film"].update(width=64, height=48)
    from mitsuba.python.xml import dict_to_xml

    dict_to_xml(box, str(source))
    monkeypatch.setattr("gpf.fitting.command.PREVIEW_ROWS", 32)
    monkeypatch.setattr(module, "ROWS", 32)
    with pytest.raises(SystemExit) as ended:
        main(["fit", str(source), "-o", str(tmp_path / "box.safetensors"), "--passes", "24"])
    assert not ended.value.code
    assert read_field(tmp_path / "box.safetensors").record["passes"] == 24
    assert mi.Bitmap(str(tmp_path / "box.png")).size() == [43, 32]
    with pytest.raises(SystemExit) as ended:
        main(["fit", str(source), "-o", str(tmp_path / "box.exr")])
    assert ended.value.code == 2

"""A field from a scene in one call, and the estimate of its quality."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

import gpf
from gpf.commands.fit import describe_fit
from gpf.core.errors import UserError
from gpf.core.images import tone_map
from gpf.fitting import plan
from gpf.fitting.field_series import FieldSeries
from gpf.fitting.quality import QualityEstimate
from gpf.rendering.field_renderer import FieldRenderer
from gpf.rendering.settings import RenderSettings
from gpf.scene.sensors import make_sensor
from gpf.scene.views import View
from gpf.training.streaming import PhotonStream
from tests.furnace import diffuse, floor, lamp, point_light
from tests.small_fit import VIEWS, sensors

pytestmark = pytest.mark.usefixtures("small")


def test_a_fit_says_how_far_it_is_and_what_it_made(scene, monkeypatch):
    monkeypatch.setattr(plan, "FIRST_PASSES", 12)
    told = []
    field = gpf.fit(scene, sensors(), passes=20, seed=3, callback=told.append)
    assert field.record["passes"] == 20 and field.record["seed"] == 3
    assert [t.passes for t in told] == sorted(t.passes for t in told)
    assert told[-1].passes == told[-1].all_passes == 20 and told[-1].steps == 60
    assert told[-1].psnr == field.record["estimated_psnr"] and told[-1].held_out_error > 0
    shown = [t for t in told if t.field is not None]
    assert len(shown) >= 2 and shown[-1] is told[-1]
    assert 24 < field.record["estimated_psnr"] < 50
    (first, before), last = field.record["fields"]
    assert (first, last) == (12, (20, field.record["estimated_psnr"])) and 20 < before < last[1] + 1
    told = describe_fit(field.record)
    assert told == f"20 passes, estimated PSNR {last[1]:.1f} dB (after 12: {before:.1f} dB)"


@pytest.mark.slow
def test_with_a_psnr_as_the_goal_there_are_as_many_passes_as_it_needs(scene, monkeypatch):
    monkeypatch.setattr(plan, "FIRST_PASSES", 4)
    asked = gpf.fit(scene, sensors(), passes=4, seed=1).record["estimated_psnr"] + 1
    record = gpf.fit(scene, sensors(), target_psnr=asked, seed=1).record
    assert record["estimated_psnr"] >= asked and record["passes"] > 4


def test_a_draft_reaches_no_goal(scene, monkeypatch):
    monkeypatch.setattr(plan, "FIRST_PASSES", 4)
    passes = [passes for passes, _ in gpf.fit(scene, sensors(), target_psnr=5).record["fields"]]
    assert len(passes) == 2 and passes[0] == 4


@pytest.mark.slow
def test_what_is_out_of_reach_ends_with_a_warning(scene, monkeypatch, caplog):
    monkeypatch.setattr("gpf.fitting.best_field.LEAST_GAIN", 30)
    field = gpf.fit(scene, sensors(), target_psnr=90)
    # The first field, and two more that gain nothing.
    assert field.record["passes"] == plan.FIRST_PASSES * plan.GROWTH**2
    assert "will not raise the estimated PSNR" in caplog.text


def test_time_ends_a_fit(scene, clock):
    record = gpf.fit(scene, sensors(), seconds=12, callback=clock.count).record
    # The last field takes all passes for which there is time.
    assert record["passes"] > 37 and 10 < record["seconds"] < 12.1
    assert record["seconds"] == clock.now


def test_a_field_that_comes_late_is_not_lost(scene, monkeypatch, clock):
    """The targets of the second take longer than the first's: the time is over before it trains."""
    monkeypatch.setattr(plan, "FIRST_PASSES", 12)
    halves = PhotonStream.halves

    def slowly(self, stride):
        clock.now += 0 if self.count == 12 else 30
        return halves(self, stride)

    monkeypatch.setattr(PhotonStream, "halves", slowly)
    record = gpf.fit(scene, sensors(), seconds=20, callback=clock.count).record
    assert record["passes"] > 12 and record["seconds"] > 30


def test_a_field_that_is_shown_does_not_change_afterwards(scene, monkeypatch):
    shown = []

    def keep(progress):
        if progress.field is not None:
            shown.append((progress.field, np.array(progress.field.gaussians.irradiance)))

    gpf.fit(scene, sensors(), passes=20, callback=keep)
    assert len(shown) >= 2
    for field, colours in shown:
        np.testing.assert_array_equal(np.array(field.gaussians.irradiance), colours)


def test_a_fit_that_failed_says_so(scene, monkeypatch, caplog):
    """By its own estimate, whatever the reason; exit code and field are as always."""
    monkeypatch.setattr(QualityEstimate, "psnr", lambda self, field: 5.8)
    field = gpf.fit(scene, sensors(), passes=4)
    assert field.record["estimated_psnr"] == 5.8
    assert "This field failed: its images have an estimated PSNR of 5.8 dB" in caplog.text
    assert "Fit longer, or with cameras that look at what matters" in caplog.text
    caplog.clear()
    monkeypatch.undo()


def test_the_time_of_a_field_does_not_count_as_that_of_a_pass(scene, monkeypatch, clock):
    """A field takes 30 s, a pass .2 s: after the first field there is time for all passes."""
    monkeypatch.setattr(plan, "FIRST_PASSES", 12)
    judge = FieldSeries.judge

    def slowly(self, *arguments):
        clock.now += 30
        judge(self, *arguments)

    monkeypatch.setattr(FieldSeries, "judge", slowly)
    record = gpf.fit(scene, sensors(), seconds=85, callback=clock.count).record
    assert record["passes"] > 20


def test_light_that_the_renderer_samples_leaves_a_black_field():
    """A floor under a bulb: no light is indirect, and lamps without a size are not in the field."""
    parts = {"floor": floor(diffuse(0.5)), "bulb": point_light((0, 0, 1), 2)}
    bare = mi.load_dict({"type": "scene"} | parts)
    view = View(name="above", origin=(0.5, 0, 3), target=(0, 0, 0), fov=40)
    field = gpf.fit(bare, [make_sensor(view, 32, 32)], passes=4)
    assert not np.array(field.gaussians.irradiance).any()
    renderer = FieldRenderer.make(bare, field, RenderSettings(adaptive=False, spp=4))
    image = renderer.render(view, (16, 16), seed=1)["radiance"]
    path = mi.load_dict({"type": "path", "max_depth": 2})
    truth = mi.render(bare, sensor=make_sensor(view, 16, 16), integrator=path, spp=64).numpy()
    np.testing.assert_allclose(image.mean(), truth.mean(), rtol=0.02)


def test_sensors_and_a_state_are_there_if_they_are_needed(scene):
    with pytest.raises(UserError, match="sensors: is empty"):
        gpf.fit(scene, [], passes=2)
    with pytest.raises(UserError, match="resume: needs a state folder"):
        gpf.fit(scene, sensors(), passes=2, resume="always")


@pytest.mark.parametrize(
    "goal", [{"seconds": 0}, {"passes": -1}, {"target_psnr": 0.0}, {"seconds": float("nan")}]
)
def test_goals_are_above_zero(scene, goal):
    with pytest.raises(UserError, match="Give a number above 0"):
        gpf.fit(scene, sensors(), **goal)


@pytest.mark.parametrize("seed", [-1, 2**31])
def test_seeds_have_31_bits(scene, seed):
    with pytest.raises(UserError, match=rf"seed: is {seed}\. Give a number from 0 to 2147483647"):
        gpf.fit(scene, sensors(), passes=2, seed=seed)


def test_what_cannot_be_fitted_is_said_before_the_first_photon():
    dark = mi.cornell_box()
    del dark["light"]
    with pytest.raises(UserError, match="has no emitters"):
        gpf.fit(mi.load_dict(dark, optimize=False), sensors(), passes=2)
    thick = mi.cornell_box()
    thick["fog"] = {
        "type": "sphere",
        "radius": 0.2,
        "bsdf": {"type": "null"},
        "interior": {"type": "homogeneous", "albedo": 1.5},
    }
    with pytest.raises(UserError, match="1.5 in the albedo"):
        gpf.fit(mi.load_dict(thick, optimize=False), sensors(), passes=2)


def test_a_scene_without_a_camera_needs_sensors():
    box = {key: value for key, value in mi.cornell_box().items() if key != "sensor"}
    with pytest.raises(UserError, match="has no perspective camera"):
        gpf.fit(mi.load_dict(box, optimize=False), passes=10)


@pytest.mark.slow
def test_lamps_without_a_size_have_sharp_shadows():
    """The renderer samples their direct light; the field holds that of the others."""
    room = mi.cornell_box()
    del room["light"]
    room["panel"] = lamp((0, 0.98, 0), (0, 0, 0), 0.5, 4, 4, 4)
    room["bulb"] = point_light((0.2, 0.6, 0.2), 1.5)
    scene = mi.load_dict(room, optimize=False)
    field = gpf.fit(scene, sensors(), passes=60, seed=2)
    kinds = [scene.emitters()[k].class_name() for k in field.settings.direct]
    assert kinds == ["PointLight"]
    view, size = VIEWS[0], (32, 32)
    renderer = FieldRenderer.make(scene, field, RenderSettings(adaptive=False, spp=256))
    path = mi.load_dict({"type": "path", "max_depth": 24})
    truth = mi.render(scene, sensor=make_sensor(view, *size), integrator=path, spp=2048).numpy()
    error = tone_map(renderer.render(view, size, seed=5)["radiance"], 0.5) - tone_map(truth, 0.5)
    psnr = -10 * np.log10(np.mean(np.square(error)))
    assert psnr > 42  # 39 with all light in the field


def test_the_order_of_the_cameras_does_not_matter(monkeypatch):
    """One sees a spot of light, where photons are dense, the other a wide floor in the dusk."""
    monkeypatch.setattr(plan, "FIRST_PASSES", 4)
    down = mi.ScalarTransform4f().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0])
    spot = {"type": "spot", "to_world": down, "cutoff_angle": 10, "intensity": 100.0}
    sky = {"type": "constant", "radiance": 0.05}
    parts = {"floor": floor(diffuse(0.5), size=40), "spot": spot, "sky": sky}
    scene = mi.load_dict({"type": "scene", **parts})
    near = View(name="near", origin=(0, -2, 2), target=(0, 0, 0), up=(0, 0, 1), fov=20)
    far = View(name="far", origin=(0, -19, 6), target=(0, 10, 0), up=(0, 0, 1), fov=60)
    cameras = [make_sensor(view, 32, 24) for view in (near, far)]
    fields = [gpf.fit(scene, order, passes=4) for order in (cameras, cameras[::-1])]
    found = [field.gaussians for field in fields]
    assert fields[0].settings == fields[1].settings
    for name in ("means", "log_scales", "irradiance"):
        np.testing.assert_array_equal(*(getattr(each, name).numpy() for each in found))

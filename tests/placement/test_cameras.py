"""Views around a scene's own camera."""

import mitsuba as mi
import numpy as np
import pytest

from benchmarks.check_scenes import SCENES
from benchmarks.measured_scenes import open_scene
from gpf.core.errors import UserError
from gpf.placement import cameras
from gpf.placement.orbit import Orbit
from gpf.placement.view_checks import report_views
from gpf.scene.views import View, ViewSets
from stages.importing.views import place_views

T = mi.ScalarTransform4f
OWN = View(name="own", origin=(0, 0, 3.9), target=(0, 0, 2.9), fov=39.3)


@pytest.fixture(scope="module")
def scene() -> mi.Scene:
    return mi.load_dict(mi.cornell_box(), optimize=False)


@pytest.fixture(scope="module")
def placed(scene):
    return place_views(scene, [OWN], aspect=1.25)


def test_the_own_camera_comes_first_and_names_are_new(placed):
    assert placed.train[0] == OWN
    assert [v.name for v in placed.train] == ["own", "train_2", "train_3"]
    assert [v.name for v in placed.novel] == [f"novel_{k}" for k in range(1, 6)]
    assert placed.aspect == 1.25


def test_what_the_scenes_camera_has_and_views_do_not_is_said(monkeypatch, caplog):
    lens = {"type": "thinlens", "aperture_radius": 0.1, "focus_distance": 3.9}
    lens["to_world"] = T().look_at(OWN.origin, OWN.target, OWN.up)
    scene = mi.load_dict(mi.cornell_box() | {"sensor": lens}, optimize=False)
    monkeypatch.setattr(cameras, "place_cameras", lambda *_: ViewSets(train=(OWN,)))
    assert len(cameras.place_sensors(scene)) == 1
    assert caplog.messages == ["sensor sensor has an aperture: views are in focus everywhere"]


def test_all_views_and_frames_are_fit_for_use(scene, placed):
    views = [*placed.train, *placed.novel, *placed.frames()]
    assert len(placed.frames()) == 24
    assert [r.faults() for r in report_views(scene, views, 1.25, seed=99)] == [[]] * len(views)


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_views_show_lit_surfaces_in_any_scene(name):
    """Four fifths of their pixels, if the scene's own camera does."""
    measured = open_scene(name)
    placed = measured.placed
    views = [measured.own, *placed.train, *placed.novel, *placed.frames()]
    reports = report_views(measured.scene, views, measured.aspect, seed=77)
    shares = [report.light_share for report in reports]
    assert shares[0] > 0.8 and len(placed.novel) == 5 and len(placed.frames()) == 24
    assert min(shares) > 0.8


def test_views_differ(placed):
    origins = np.array([v.origin for v in (*placed.train, *placed.novel)])
    gaps = np.linalg.norm(origins[:, None] - origins[None], axis=-1) + 9 * np.eye(len(origins))
    assert gaps.min() > 0.2


def test_a_second_sensor_becomes_a_training_view_whatever_its_name(scene):
    where = {"origin": (0.5, 0.2, 3.5), "target": (0, 0, 0)}
    second = OWN.model_copy(update={"name": "train_3", **where})
    placed = place_views(scene, [OWN, second], aspect=1)
    assert placed.train[:2] == (OWN, second)
    assert len({v.name for v in (*placed.train, *placed.novel)}) == 8


def test_an_orbit_stays_in_the_room(scene):
    inside = View(name="a", origin=(0, 0, 0.9), target=(0, 0, 0), fov=60)
    orbit = Orbit.around(scene, inside, 1)
    for azimuth in (-60, 60):
        x, y, _ = orbit.views(scene, [(azimuth, 50, 2)])[0].origin
        assert abs(x) < 1 and abs(y) < 1


def test_orbit_geometry(scene):
    orbit = Orbit.around(scene, OWN, 1)
    assert orbit.pivot[:2] == pytest.approx([0, 0], abs=1e-6)
    assert orbit.distance == pytest.approx(3.9 - orbit.pivot[2])
    turned, higher = orbit.views(scene, [(90, 0, 0.1), (0, 30, 1)])
    np.testing.assert_allclose(
        np.subtract(turned.origin, orbit.pivot), [0.1 * orbit.distance, 0, 0], atol=1e-4
    )
    assert higher.origin[1] == pytest.approx(orbit.distance / 2, rel=1e-4)


def test_under_water_candidates_stay_under_water():
    box = mi.cornell_box()
    flat = T().translate([0, 0.9, 0]).rotate([1, 0, 0], -90).scale(5)
    box["water"] = {"type": "rectangle", "to_world": flat, "bsdf": {"type": "dielectric"}}
    inside = View(name="diver", origin=(0, 0, 3.9), target=(0, 0, 0), fov=39.3)
    placed = place_views(mi.load_dict(box, optimize=False), [inside], aspect=1)
    assert placed.train[0] == inside
    assert all(view.origin[1] < 0.9 for view in (*placed.train, *placed.novel))


def test_a_camera_that_sees_nothing_is_told_so(scene):
    away = View(name="away", origin=(0, 0, 3.9), target=(0, 0, 9), fov=39)
    with pytest.raises(UserError, match="view 'away': sees no diffuse surface. Point the"):
        place_views(scene, [away], aspect=1)

"""Fields for the frames of an animation."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy.spatial import cKDTree

import gpf
from gpf.core.errors import UserError
from gpf.core.structs import to_numpy
from gpf.fitting import frames
from gpf.guiding.emission_plan import EmissionPlan
from gpf.scene.sensors import make_sensor
from tests.guiding.rooms import RIGHT_ROOM, two_rooms
from tests.small_fit import assert_same_gaussians, sensors


def box(
    light: float = 1.0, eye: float = 3.9, lift: float = 0.0, fine: int = 0, more: dict | None = None
) -> mi.Scene:
    """The Cornell box with a lamp of another brightness, another place of its camera, a small box
    that is lifted, or one with more triangles, or with one thing more."""
    found = mi.cornell_box()
    found["light"]["emitter"]["radiance"]["value"] = [light * c for c in (18.4, 15.6, 8.0)]
    look = mi.ScalarTransform4f().look_at(origin=[0, 0, eye], target=[0, 0, 0], up=[0, 1, 0])
    found["sensor"]["to_world"] = look
    small = mi.ScalarTransform4f().translate([0, lift, 0]) @ found["small-box"]["to_world"]
    found["small-box"]["to_world"] = small
    if fine:
        found["small-box"]["type"] = "sphere"
    if more:
        found["more"] = more
    return mi.load_dict(found, optimize=False)


def light_at(field: gpf.GaussianPhotonField, x: np.ndarray, y: float, z: np.ndarray) -> np.ndarray:
    """Irradiance of upward places, (N, 3)."""
    x, z = (v.ravel().astype(np.float32) for v in np.meshgrid(x, z))
    p = mi.Point3f(mi.Float(x), y, mi.Float(z))
    value, _ = field.query(p, mi.Normal3f(0, 1, 0), dr.full(mi.Bool, True, len(x)))
    return to_numpy(value)


def floor_light(field: gpf.GaussianPhotonField) -> float:
    """Mean irradiance of some places on the floor, in front of the boxes."""
    return float(light_at(field, np.linspace(-0.8, 0.8, 9), -1, np.linspace(0.75, 0.95, 3)).mean())


def test_what_does_not_change_keeps_its_field(small):
    """Its Gaussians go on with their training; another seed changes the light more. The second
    frame changes more than the others: shapes in smooth light become rounder."""
    first, *fields = gpf.fit_frames([box() for _ in range(4)], sensors(), passes=6)
    (other,) = gpf.fit_frames([box()], sensors(), passes=6, seed=1)
    places = np.linspace(-0.8, 0.8, 20), -1, np.linspace(0.75, 0.95, 10)  # not under the box
    a, *later, c = (light_at(field, *places) for field in (first, *fields, other))
    assert np.abs(np.diff(later, axis=0)).mean() < 0.5 * np.abs(c - a).mean()
    assert np.abs(later[0] - a).mean() < 0.8 * np.abs(c - a).mean()
    counts = [dr.width(field.gaussians.means) for field in (first, *fields)]
    np.testing.assert_allclose(counts[1:], counts[:-1], rtol=0.03)
    assert first.record["passes"] == 6
    assert first.error is not None


def test_guided_emission_stays_the_same(small, monkeypatch):
    """Also from a field that was made earlier."""
    made, make = [], EmissionPlan.make
    monkeypatch.setattr(EmissionPlan, "make", lambda *given: made.append(make(*given)) or made[-1])
    rooms, views = [two_rooms(gap) for gap in (0.1, 0.11, 0.12)], [make_sensor(RIGHT_ROOM, 8, 6)]
    fields = list(gpf.fit_frames(rooms, views, passes=6))
    assert len(made) == 1 and made[0].facts()["emission_guided"]
    before = frames.Frame(rooms[0], fields[0])
    (later,) = gpf.fit_frames(rooms[1:2], views, passes=6, before=before)
    assert len(made) == 2
    np.testing.assert_array_equal(made[1].pilot.power, made[0].pilot.power)
    assert_same_gaussians(later, fields[1])


def test_a_small_lamp_comes_and_goes(small):
    """Its direct light is sampled, not stored; each field says so of its own frame's lamps."""
    point = {"type": "point", "position": [0, 0.5, 0], "intensity": 0.5}
    scenes = box(), box(more=point), box()
    *_, third = found = list(gpf.fit_frames(scenes, sensors(), passes=20))
    assert [field.settings.direct for field in found] == ["field", (1,), "field"]
    assert floor_light(third) == pytest.approx(floor_light(found[0]), rel=0.05)


def test_a_scene_that_grows_keeps_its_gaussians(small, caplog):
    """A plate behind the camera moves away from the box, beyond the first frame's grid."""

    def plate(z):
        to_world = mi.ScalarTransform4f().translate([-2, -2, z]).scale(0.1)
        return {"type": "rectangle", "to_world": to_world}

    first, second = gpf.fit_frames([box(more=plate(z)) for z in (-2, -3)], sensors(), passes=6)
    assert second.detail.corner[2] < -3 < first.detail.corner[2]
    assert second.detail.table.shape[:2] == first.detail.table.shape[:2]
    before, after = (
        field.detail.fold(to_numpy(field.gaussians.means)) for field in (first, second)
    )
    distance, _ = cKDTree(after).query(before)
    (other,) = gpf.fit_frames([box(more=plate(-3))], sensors(), passes=6, seed=1)
    unrelated, _ = cKDTree(other.detail.fold(to_numpy(other.gaussians.means))).query(before)
    assert np.median(distance) < 0.3 * np.median(unrelated)
    places = np.linspace(-0.8, 0.8, 20), -1, np.linspace(0.75, 0.95, 10)
    a, b = (light_at(field, *places) for field in (first, second))
    np.testing.assert_allclose(b.mean(), a.mean(), rtol=0.03)
    *_, last = gpf.fit_frames([box(more=plate(z)) for z in (-2, -1000)], sensors(), passes=6)
    assert frames.OUTGROWN in caplog.text
    assert floor_light(last) == pytest.approx(floor_light(first), rel=0.2)


def test_the_same_seed_gives_the_same_bits(small):
    (_, first), (_, second) = (
        gpf.fit_frames([box(), box(lift=0.1)], sensors(), passes=6) for _ in range(2)
    )
    assert_same_gaussians(second, first)


@pytest.mark.parametrize("light", [4, 100, 1e-3])
def test_each_frame_has_its_own_light(small, light):
    scenes = box(), box(light), box()
    first, second, third = gpf.fit_frames(scenes, sensors(), passes=20)
    assert floor_light(second) == pytest.approx(light * floor_light(first), rel=0.05)
    assert floor_light(third) == pytest.approx(floor_light(first), rel=0.05)


def test_a_box_rises(small):
    """Its light is that of a field that has seen nothing else."""
    lifts = 0.1, 0.2
    *_, field = gpf.fit_frames([box(), *(box(lift=lift) for lift in lifts)], sensors(), passes=30)
    (alone,) = gpf.fit_frames([box(lift=lifts[-1])], sensors(), passes=30)
    bounds = next(s for s in box(lift=lifts[-1]).shapes() if s.id() == "small-box").bbox()
    x, z = (0.5 * (bounds.min[k] + bounds.max[k]) + np.linspace(-0.1, 0.1, 5) for k in (0, 2))
    found, expected = (light_at(f, x, float(bounds.max[1]), z) for f in (field, alone))
    assert found.mean() == pytest.approx(expected.mean(), rel=0.05)
    assert expected.mean() > 0.3


def test_another_topology_begins_anew(small, caplog):
    scenes = [box(), box(fine=1)]
    *_, field = gpf.fit_frames(scenes, sensors(), passes=20)
    assert "begins anew: small-box" in caplog.text
    (alone,) = gpf.fit_frames(scenes[1:], sensors(), passes=20)
    assert floor_light(field) == pytest.approx(floor_light(alone), rel=0.05)


def test_the_light_is_that_of_a_fit(small):
    found, expected = [], []
    for seed in range(3):  # each differs by 1 % from the mean
        (field,) = gpf.fit_frames([box()], sensors(), passes=30, seed=seed)
        found.append(floor_light(field))
        expected.append(floor_light(gpf.fit(box(), sensors(), passes=30, seed=seed)))
    assert np.mean(found) == pytest.approx(np.mean(expected), rel=0.03)


def test_lamps_are_kept_apart(small):
    groups = gpf.scene.light_groups.LightGroups.each(box())
    (field,) = gpf.fit_frames([box()], sensors(), passes=6, groups=groups)
    assert field.lights.groups.names == groups.names


def test_time_is_an_end(small):
    fields = gpf.fit_frames([box()], sensors(), seconds=0.01)
    assert next(fields).record["passes"] == frames.LEAST_PASSES


def test_cameras_are_placed_again_where_the_own_one_moves(small, monkeypatch):
    placed = []

    def place(scene: mi.Scene) -> list[mi.Sensor]:
        placed.append(scene)
        return sensors()

    monkeypatch.setattr(frames, "place_sensors", place)
    start = box()
    first, *_ = gpf.fit_frames([start, box(light=2), box(eye=3.5)], passes=6)
    assert len(placed) == 2
    before = frames.Frame(start, first)
    for scene in (box(light=2), box(eye=3.5)):
        next(gpf.fit_frames([scene], passes=6, before=before))
        assert placed[-1] is (start if len(placed) == 3 else scene)


def test_what_is_wrong_is_said(small):
    with pytest.raises(UserError, match="no photon reached a diffuse surface"):
        next(gpf.fit_frames([box(0)], sensors(), passes=6))
    with pytest.raises(UserError, match="sensors"):
        next(gpf.fit_frames([box()], []))
    with pytest.raises(UserError, match="seed"):
        next(gpf.fit_frames([box()], sensors(), seed=-1))
    with pytest.raises(UserError, match="seconds"):
        next(gpf.fit_frames([box()], sensors(), seconds=0))

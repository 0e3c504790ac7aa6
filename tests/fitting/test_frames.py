"""Fields for the frames of an animation."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

import gpf
from gpf.core.errors import UserError
from gpf.fitting import frames
from tests.small_fit import assert_same_gaussians, sensors


def box(light: float = 1.0, eye: float = 3.9) -> mi.Scene:
    """The Cornell box with a lamp of another brightness, or another place of its camera."""
    found = mi.cornell_box()
    found["light"]["emitter"]["radiance"]["value"] = [light * c for c in (18.4, 15.6, 8.0)]
    look = mi.ScalarTransform4f().look_at(origin=[0, 0, eye], target=[0, 0, 0], up=[0, 1, 0])
    found["sensor"]["to_world"] = look
    return mi.load_dict(found, optimize=False)


def floor_light(field: gpf.GaussianPhotonField) -> float:
    """Mean irradiance of some places on the floor, in front of the boxes."""
    x, z = dr.meshgrid(dr.linspace(mi.Float, -0.8, 0.8, 9), dr.linspace(mi.Float, 0.75, 0.95, 3))
    p, n = mi.Point3f(x, -1, z), mi.Normal3f(0, 1, 0)
    value, _ = field.query(p, n, dr.full(mi.Bool, True, dr.width(x)))
    return float(np.mean(value.numpy()))


def test_what_does_not_change_has_the_same_field(small):
    first, second = gpf.fit_frames([box(), box()], sensors(), passes=6)
    assert_same_gaussians(second, first)
    assert first.record["passes"] == 6
    assert first.error is not None


def test_each_frame_has_its_own_light(small):
    first, second, third = gpf.fit_frames([box(), box(light=4), box()], sensors(), passes=6)
    assert floor_light(second) == pytest.approx(4 * floor_light(first), rel=1e-3)
    assert_same_gaussians(third, first)


def test_the_light_is_that_of_a_fit(small):
    (field,) = gpf.fit_frames([box()], sensors(), passes=30)
    assert floor_light(field) == pytest.approx(
        floor_light(gpf.fit(box(), sensors(), passes=30)), rel=0.03
    )


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
    for _ in gpf.fit_frames([box(), box(light=2), box(eye=3.5)], passes=6):
        pass
    assert len(placed) == 2


def test_what_is_wrong_is_said(small):
    with pytest.raises(UserError, match="sensors"):
        next(gpf.fit_frames([box()], []))
    with pytest.raises(UserError, match="seed"):
        next(gpf.fit_frames([box()], sensors(), seed=-1))
    with pytest.raises(UserError, match="seconds"):
        next(gpf.fit_frames([box()], sensors(), seconds=0))

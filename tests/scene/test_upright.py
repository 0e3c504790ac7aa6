"""The vertical of a scene, from cameras whose matrices only say how they pitch."""

from __future__ import annotations

import json

import mitsuba as mi
import numpy as np
import pytest

from gpf.baking.gltf import is_z_up
from gpf.blender.conversion import _write_views
from gpf.placement.orbit import Orbit
from gpf.scene.pinhole import make_pinhole
from gpf.scene.sensors import views_of_sensors
from gpf.scene.transforms import read_cameras, write_transforms
from gpf.scene.views import View

T = mi.ScalarTransform4f
UPS = {"y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
SIZE = (80, 60)


def looking(vertical: str, azimuth: float, pitch: float, name: str = "eye") -> View:
    """A camera 5 units from the origin, looking there; it pitches down by ``pitch`` degrees."""
    a, p = np.radians([azimuth, pitch])
    level, height = 5 * np.cos(p) * np.array([np.cos(a), np.sin(a)]), 5 * np.sin(p)
    x, y = level.tolist()
    place = (x, y, height) if vertical == "z" else (y, height, x)
    return View(name=name, origin=place, target=(0, 0, 0), up=UPS[vertical], fov=40)


def scene_of(*views: View, **shapes: dict) -> mi.Scene:
    """A scene with sensors at the views; of their up vectors, only the picture is left."""
    sensors = {
        view.name: {
            "type": "perspective",
            "fov": view.fov,
            "to_world": T().look_at(list(view.origin), list(view.target), list(view.up)),
        }
        for view in views
    }
    return mi.load_dict({"type": "scene", **sensors, **shapes}, optimize=False)


@pytest.mark.parametrize("vertical", ["y", "z"])
@pytest.mark.parametrize(
    ("azimuth", "pitch"), [(46.7, 26), (45, 63), (30, 85), (200, -40), (0, 0), (90, 63), (270, 63)]
)
def test_a_camera_that_pitches_tells_the_vertical(vertical, azimuth, pitch, tmp_path):
    """Of the sensor, and of a file with matrices; the picture stays as it was."""
    view = looking(vertical, azimuth, pitch)
    write_transforms(tmp_path / "transforms.json", [view], SIZE)
    for found in (
        views_of_sensors(scene_of(view))[0],
        read_cameras(tmp_path / "transforms.json").train[0],
    ):
        assert found.up == UPS[vertical]
        expected = make_pinhole(view, SIZE).rotation
        np.testing.assert_allclose(make_pinhole(found, SIZE).rotation, expected, atol=1e-5)


def test_a_camera_that_rolls_keeps_its_picture(tmp_path):
    view = looking("z", 30, 20).model_copy(update={"up": (0.2, 0.0, 1.0)})
    (found,) = views_of_sensors(scene_of(view))
    expected = make_pinhole(view, SIZE).rotation
    np.testing.assert_allclose(make_pinhole(found, SIZE).rotation, expected, atol=1e-5)


def test_most_cameras_tell_what_the_first_does_not(tmp_path):
    """The first could as well look up in a scene whose vertical is y."""
    views = [looking("z", 270, 75, "first"), looking("z", 20, 30, "other"), looking("z", 50, 10)]
    alone = views_of_sensors(scene_of(views[0]))[0]
    assert alone.up == UPS["y"]
    assert {view.up for view in views_of_sensors(scene_of(*views))} == {UPS["z"]}
    path = tmp_path / "transforms.json"
    write_transforms(path, views, SIZE)
    assert {view.up for view in read_cameras(path).train} == {UPS["z"]}
    assert len(json.loads(path.read_text())["frames"]) == 3


def test_orbits_and_gltf_follow_a_steep_camera():
    floor = {"type": "rectangle", "to_world": T().scale(20)}  # faces +z
    ball = {"type": "sphere", "center": [0, 0, 1]}
    scene = scene_of(looking("z", 40, 63), floor=floor, ball=ball, lamp={"type": "constant"})
    views = views_of_sensors(scene)
    assert is_z_up(views)
    orbit = Orbit.around(scene, views[0], 1.0)
    np.testing.assert_array_equal(orbit.up, [0, 0, 1])
    heights = [view.origin[2] for view in orbit.circle(6)]
    np.testing.assert_allclose(heights, heights[0], rtol=1e-5)


def test_a_moving_camera_of_blender_stands_upright(tmp_path):
    """In Blender, cameras look along their -z, and the vertical is z."""
    poses = [make_pinhole(looking("z", 20 * k, 63), SIZE).pose for k in range(3)]
    matrices = [(pose @ np.diag([1, -1, -1, 1])).tolist() for pose in poses]
    lens = {"type": "PERSP", "name": "Camera", "fov": 40, "fov_axis": "x", "shift": [0, 0]}
    frames = [{"matrix": matrix, "fov": 40} for matrix in matrices]
    moving = lens | frames[0] | {"frames": frames}
    found = {"cameras": [moving], "size": list(SIZE), "exposure": 1.0}
    _write_views(found, tmp_path / "views.yaml")
    views = read_cameras(tmp_path / "views.yaml")
    cameras = (*views.train, *views.frames())
    assert len(cameras) == 7 and {camera.up for camera in cameras} == {UPS["z"]}

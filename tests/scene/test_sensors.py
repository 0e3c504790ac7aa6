"""A view made from a scene's own sensor gives the same rays; what it leaves out is said."""

import mitsuba as mi
import numpy as np
import pytest

from gpf.core.errors import UserError
from gpf.scene.pinhole import make_pinhole
from gpf.scene.sensors import (
    differs_from_view,
    film_aspect,
    looks_through,
    make_sensor,
    scene_cameras,
    views_of_sensors,
)

T = mi.ScalarTransform4f


def load(*sensors: dict, **others: dict) -> mi.Scene:
    named = {f"sensor_{i}": sensor for i, sensor in enumerate(sensors)}
    return mi.load_dict({"type": "scene", **named, **others}, optimize=False)


def camera(origin=(0.5, 1.5, 4), target=(0.3, 0, -1), size=(15, 6), **more) -> dict:
    pose = T().look_at(list(origin), list(target), [0.2, 1, 0.1])
    film = {"type": "hdrfilm", "width": size[0], "height": size[1]}
    return {"type": "perspective", "to_world": pose, "film": film, "fov": 40, **more}


def rays(sensor: mi.Sensor) -> tuple[np.ndarray, np.ndarray]:
    place = mi.Point2f([0.0, 0.5, 0.1, 0.9, 1.0], [0.0, 0.5, 0.8, 0.3, 1.0])
    ray, _ = sensor.sample_ray(0.0, 0.5, place, mi.Point2f(0.5))
    return np.array(ray.o).T, np.array(ray.d).T


@pytest.mark.parametrize("axis", ["x", "y", "diagonal", "smaller", "larger"])
@pytest.mark.parametrize("size", [(15, 6), (4, 9)])
def test_views_give_the_rays_of_the_sensor(axis, size):
    scene = load(camera(fov_axis=axis, size=size))
    (view,) = views_of_sensors(scene)
    own = scene.sensors()[0]
    assert view.fov_axis == "x"
    assert film_aspect(own) == size[0] / size[1]
    (origins, directions), (made_origins, made) = rays(own), rays(make_sensor(view, *size))
    np.testing.assert_allclose(made, directions, atol=2e-6)
    np.testing.assert_allclose(made_origins, origins, atol=2e-2)  # their near clips differ
    assert differs_from_view(own, view) == []
    np.testing.assert_allclose(np.linalg.norm(np.subtract(view.target, view.origin)), 1, atol=1e-5)


def test_far_from_the_origin_directions_stay_exact():
    scene = load(camera(origin=(27800, -27300.5, 8000), target=(27800, -27300, 7000)))
    (view,) = views_of_sensors(scene)
    assert view.origin == (27800, -27300.5, 8000)
    made = make_sensor(view, 15, 6)
    np.testing.assert_allclose(rays(made)[1], rays(scene.sensors()[0])[1], atol=2e-3)
    assert differs_from_view(scene.sensors()[0], view) == []


def test_numbers_are_as_short_as_they_were():
    scene = load(camera(origin=(4.05402, 1.61647, -2.30652), target=(3.05402, 1.61647, -2.30652)))
    (view,) = views_of_sensors(scene)
    assert view.origin == (4.05402, 1.61647, -2.30652)
    assert view.target == (3.05402, 1.61647, -2.30652)


def test_names_come_from_ids_and_are_all_different():
    sensors = {"Main Camera": camera(), "frame_7": camera(), "main camera": camera()}
    scene = mi.load_dict({"type": "scene", **sensors}, optimize=False)
    names = sorted(view.name for view in views_of_sensors(scene))
    assert names == ["camera_frame_7", "main_camera", "main_camera_2"]
    nameless = '<scene version="3.0.0"><sensor type="perspective"/></scene>'
    assert views_of_sensors(mi.load_string(nameless))[0].name == "camera"


def test_only_cameras_become_views():
    one_pixel = {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}}
    meter = {"type": "radiancemeter", "film": one_pixel}
    scene = load(meter, camera(), {"type": "orthographic"})
    assert [sensor.class_name() for sensor in scene_cameras(scene)] == ["PerspectiveCamera"]
    assert len(views_of_sensors(scene)) == 1


def mirrored() -> dict:
    pose = camera()["to_world"] @ T().scale([-1, 1, 1])
    return camera(to_world=pose)


@pytest.mark.parametrize(
    ("sensor", "words"),
    [
        (camera(type="thinlens", aperture_radius=0.1), ["has an aperture"]),
        (mirrored(), ["shows a mirror image"]),
        (
            camera(film={"type": "hdrfilm", "width": 8, "height": 6, "crop_width": 4}),
            ["shows a crop of its film"],
        ),
    ],
)
def test_what_a_view_leaves_out_is_said(sensor, words):
    scene = load(sensor)
    found = differs_from_view(scene.sensors()[0], views_of_sensors(scene)[0])
    assert len(found) == len(words)
    assert all(said.startswith(w) for said, w in zip(found, words, strict=True))


def test_a_principal_point_off_centre_is_a_shift():
    """The view has the sensor's rays; the pinhole camera projects onto its pixels."""
    scene = load(camera(principal_point_offset_x=0.1, principal_point_offset_y=-0.25))
    (view,) = views_of_sensors(scene)
    assert view.shift == (0.1, -0.25)
    assert differs_from_view(scene.sensors()[0], view) == []
    size = 80, 60
    for place in ((0.3, 0.8), (0.5, 0.5)):
        ray, _ = make_sensor(view, *size).sample_ray(0, 0, place, [0, 0])
        point = np.array(ray.o).ravel() + 3 * np.array(ray.d).ravel()
        pixels, _ = make_pinhole(view, size).project(point[None])
        np.testing.assert_allclose(pixels[0], np.array(place) * size, atol=1e-2)


def test_what_the_near_clip_hides_is_measured():
    right_half = {
        "type": "rectangle",
        "to_world": T().translate([5, 0, -2]).scale([5, 99, 1]),
    }
    sensor = camera(origin=(0, 0, 0), target=(0, 0, -1), size=(6, 6))
    sensor["to_world"] = T().look_at([0, 0, 0], [0, 0, -1], [0, 1, 0])
    scene = load(sensor, wall=right_half)
    (view,) = views_of_sensors(scene)
    assert looks_through(scene, scene.sensors()[0], view) == []
    scene = load({**sensor, "near_clip": 4.0}, wall=right_half)
    (said,) = looks_through(scene, scene.sensors()[0], view)
    assert said.startswith("clips everything nearer than 4 units")
    assert "50% of this one" in said


@pytest.mark.parametrize("distance", [2.0**63, 3e30])
def test_a_camera_without_a_direction_is_told(distance):
    far = T().look_at([0, distance, 1], [0, 0, 0], [0, 0, 1])  # a step ahead changes no digit
    scene = mi.load_dict(
        {"type": "scene", "eye": {"type": "perspective", "id": "eye", "to_world": far}}
    )
    with pytest.raises(UserError, match=r"sensor 'eye': .* Correct its to_world and its fov"):
        views_of_sensors(scene)

"""Mitsuba sensors for views, and views for the sensors of a scene."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from pydantic import ValidationError

from gpf.core.errors import UserError
from gpf.core.vectors import normalise
from gpf.core.yaml import explain
from gpf.scene.upright import upright
from gpf.scene.views import View, name_view


def make_sensor(
    view: View,
    width: int,
    height: int,
    spp: int = 16,
    sampler: str = "independent",
    medium: mi.Medium | None = None,
) -> mi.Sensor:
    """A Mitsuba perspective sensor for a view: RGB float32 film, box filter.

    With the box filter, a pixel is the mean of its own samples for all methods.

    Parameters
    ----------
    width, height: pixels.
    spp: samples per pixel.
    sampler: name of the sampler plugin.
    medium: what the camera is in, for Mitsuba's integrators; ours find out.
    """
    look_at = mi.ScalarTransform4f().look_at(
        origin=list(view.origin), target=list(view.target), up=list(view.up)
    )
    inside = {} if medium is None else {"medium": medium}
    return mi.load_dict(
        inside
        | {
            "type": "perspective",
            "fov": view.fov,
            "fov_axis": view.fov_axis,
            "near_clip": 1e-7,  # whatever the scene's unit; directions stay as exact
            "far_clip": 1e9,
            "principal_point_offset_x": view.shift[0],
            "principal_point_offset_y": view.shift[1],
            "to_world": look_at,
            "sampler": {"type": sampler, "sample_count": spp},
            "film": {
                "type": "hdrfilm",
                "width": width,
                "height": height,
                "pixel_format": "rgb",
                "component_format": "float32",
                "rfilter": {"type": "box"},
            },
        }
    )


CAMERAS = ("PerspectiveCamera", "ThinLensCamera")
"""Classes of the sensors that a view can represent."""


def scene_cameras(scene: mi.Scene) -> list[mi.Sensor]:
    """The sensors of the scene that a view can represent, in order."""
    return [sensor for sensor in scene.sensors() if sensor.class_name() in CAMERAS]


def views_of_sensors(scene: mi.Scene) -> list[View]:
    """One view per sensor from :func:`scene_cameras`.

    ``target`` is one unit in front of ``origin``, ``up`` is the scene's vertical unless the camera
    rolls (:func:`gpf.scene.upright.upright`), and ``fov`` is the angle across x. Names come from
    the ids of the sensors; without an id, the name is ``camera``. A view is a pinhole camera: it
    has no aperture, film crop or mirrored image (:func:`shown_differently` reports these).

    Raises
    ------
    UserError: the transform of a sensor is not finite, or has no direction.
    """
    views: list[View] = []
    for sensor in scene_cameras(scene):
        taken = {view.name for view in views}
        matrix = _matrix(sensor)
        origin = np.array([_shortest(x) for x in matrix[:3, 3]])
        ahead = origin + normalise(matrix[:3, 2])
        try:
            view = View(
                name=name_view(sensor.id(), taken, otherwise="camera"),
                origin=_vector(origin),
                target=_vector(ahead.round(6) + 0.0),
                up=_vector(normalise(matrix[:3, 1]).round(6) + 0.0),
                fov=_shortest(_scalar(mi.traverse(sensor)["x_fov"])),
                fov_axis="x",
                shift=tuple(_shortest(_principal_point(sensor, axis)) for axis in "xy"),
            )
        except ValidationError as error:
            told = explain(f"sensor {sensor.id()!r}", View, error)
            raise UserError(told.where, told.what, "Correct its to_world and its fov.") from error
        views.append(view)
    return upright(views)


def film_aspect(sensor: mi.Sensor) -> float:
    """Width divided by height of the whole film of a sensor."""
    size = sensor.film().size()
    return float(size[0]) / float(size[1])


def differs_from_view(sensor: mi.Sensor, view: View) -> list[str]:
    """Descriptions of the sensor's properties that its view lacks; empty if their images agree."""
    found = []
    if sensor.class_name() == "ThinLensCamera":
        found.append("has an aperture: views are in focus everywhere")
    if np.linalg.det(_matrix(sensor)[:3, :3]) < 0:
        found.append("shows a mirror image: views are not mirrored")
    if list(sensor.film().crop_size()) != list(sensor.film().size()):
        found.append("shows a crop of its film: views show the whole film")
    width, height = (int(n) for n in sensor.film().size())
    if not found and not _same_rays(sensor, make_sensor(view, width, height)):
        found.append("generates different rays from a pinhole camera")
    return found


def looks_through(scene: mi.Scene, sensor: mi.Sensor, view: View) -> list[str]:
    """Describe what the sensor's near clip hides but the view shows; empty if nothing."""
    near, aspect = float(sensor.near_clip()), film_aspect(sensor)
    rows, columns = 32, max(1, round(32 * aspect))
    index = dr.arange(mi.UInt32, rows * columns)
    pixel = mi.Point2f(index % columns, index // columns) + 0.5
    place = pixel / mi.Point2f(columns, rows)
    ray, _ = make_sensor(view, columns, rows).sample_ray(0.0, 0.5, place, mi.Point2f(0.5))
    ray.maxt = mi.Float(near)
    share = float(dr.count(scene.ray_test(mi.Ray3f(ray)))[0]) / (rows * columns)
    if share == 0:
        return []
    return [
        f"clips everything nearer than {near:.3g} units: "
        f"views do not, and it covers {100 * share:.0f}% of this one"
    ]


def shown_differently(scene: mi.Scene) -> list[str]:
    """What the views of the scene's sensors show differently from the sensors, in words."""
    return [
        f"sensor {view.name} {what}"
        for sensor, view in zip(scene_cameras(scene), views_of_sensors(scene), strict=True)
        for what in (*differs_from_view(sensor, view), *looks_through(scene, sensor, view))
    ]


def _same_rays(first: mi.Sensor, second: mi.Sensor) -> bool:
    corner, centre = mi.Point2f(0.1, 0.8), mi.Point2f(0.5)
    rays = [sensor.sample_ray(0.0, 0.5, corner, centre)[0] for sensor in (first, second)]
    directions = [np.array(ray.d).ravel() for ray in rays]
    return bool(np.abs(directions[0] - directions[1]).max() < 1e-3)


def _principal_point(sensor: mi.Sensor, axis: str) -> float:
    key = f"principal_point_offset_{axis}"
    parameters = mi.traverse(sensor)
    return _scalar(parameters[key]) if key in parameters else 0.0


def _matrix(sensor: mi.Sensor) -> np.ndarray:
    return np.array(sensor.world_transform().matrix, dtype=np.float64).reshape(4, 4)


def _scalar(value: Any) -> float:
    return float(np.array(value).ravel()[0])


def _shortest(value: float) -> float:
    """The shortest decimal with the same value in single precision: 4.054 for 4.0539999."""
    return float(str(np.float32(value))) + 0.0


def _vector(values: Any) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    return x, y, z

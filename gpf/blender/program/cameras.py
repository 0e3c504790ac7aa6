"""Cameras, and where they are in each frame."""

from __future__ import annotations

import math
from typing import Any

import numpy as np


def read_cameras(scene: Any, path: bool) -> list[dict[str, Any]]:
    """The scene's own camera, then the others, by name; see :func:`read_camera`."""
    cameras = sorted((o for o in scene.objects if o.type == "CAMERA"), key=lambda o: o.name)
    own = [scene.camera] if scene.camera is not None and scene.camera.type == "CAMERA" else []
    every = [*own, *(c for c in cameras if c not in own)]
    return [read_camera(scene, each, path) for each in every]


def read_camera(scene: Any, camera: Any, path: bool) -> dict[str, Any]:
    """A camera in plain values.

    ``matrix`` is 4×4; the camera looks along its -z, and +y is up. With ``path``, ``frames`` has
    the matrices and angles of all frames, if the camera moves or zooms.
    """
    data = camera.data
    axis = {"AUTO": "larger", "HORIZONTAL": "x", "VERTICAL": "y"}[data.sensor_fit]
    found = {
        "name": camera.name,
        "type": data.type,
        "fov_axis": axis,
        "shift": [float(data.shift_x), float(data.shift_y)],
        "clip": [float(data.clip_start), float(data.clip_end)],
        "blurred": data.dof.use_dof,
        **_pose(camera),
    }
    if path and (frames := _path(scene, camera)):
        found["frames"] = frames
    return found


def frame_numbers(scene: Any) -> list[int]:
    """The numbers of a scene's frames."""
    return list(range(scene.frame_start, scene.frame_end + 1, max(scene.frame_step, 1)))


def _pose(camera: Any) -> dict[str, Any]:
    data = camera.data
    sensor = data.sensor_height if data.sensor_fit == "VERTICAL" else data.sensor_width
    fov = math.degrees(2 * math.atan(sensor / (2 * data.lens)))
    return {"matrix": np.array(camera.matrix_world).tolist(), "fov": fov}


def _path(scene: Any, camera: Any) -> list[dict[str, Any]]:
    now = scene.frame_current
    poses = []
    for frame in frame_numbers(scene):
        scene.frame_set(frame)
        poses.append(_pose(camera))
    scene.frame_set(now)
    moves = any(pose != poses[0] for pose in poses[1:])
    return poses if moves else []

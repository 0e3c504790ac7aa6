"""Views as ``transforms.json``, the camera format of NeRF, nerfstudio and gsplat.

``transform_matrix`` maps from the camera to the world; the camera looks along its -z, and y is up.
Focal lengths and image sizes are in pixels. Written files give them once for all frames; files to
be read may give them per frame, or ``camera_angle_x`` (radians) instead.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
from PIL import Image
from pydantic import ValidationError

from gpf.core.errors import UserError
from gpf.core.files import write_text
from gpf.core.yaml import explain
from gpf.scene.pinhole import Pinhole, make_pinhole
from gpf.scene.sensors import make_sensor
from gpf.scene.upright import upright
from gpf.scene.views import SceneViews, View, ViewSets, name_view, read_views

# From the computer-vision camera (y down, z forward) to the OpenGL camera (y up, z backward).
_FLIP = np.diag([1.0, -1.0, -1.0, 1.0])

_DISTORTIONS = ("k1", "k2", "k3", "k4", "p1", "p2")


def write_transforms(
    path: Path,
    views: Sequence[View],
    size: tuple[int, int],
    files: Mapping[str, Mapping[str, Any]] | None = None,
    more: Mapping[str, str] | None = None,
) -> None:
    """Write the cameras of views.

    Parameters
    ----------
    size: width and height of the images, pixels.
    files: view name -> further keys of its frame, such as ``file_path``, as JSON values.
    more: further top-level keys, such as ``ply_file_path``.
    """
    width, height = size
    cameras = [make_pinhole(view, size) for view in views]
    lenses = [_lens(camera) for camera in cameras]
    shared: dict[str, float] = {}
    if all(lens == lenses[0] for lens in lenses):
        shared, lenses = lenses[0], [{} for _ in cameras]
    content = {
        "camera_model": "OPENCV",
        "w": width,
        "h": height,
        **shared,
        **(more or {}),
        "frames": [
            {
                "name": view.name,
                **(files or {}).get(view.name, {}),
                **extra,
                "transform_matrix": (camera.pose @ _FLIP).tolist(),
            }
            for view, camera, extra in zip(views, cameras, lenses, strict=True)
        ],
    }
    write_text(path, json.dumps(content, indent=2) + "\n")


def _lens(camera: Pinhole) -> dict[str, float]:
    """Focal lengths and principal point, pixels."""
    x, y = camera.centre
    return {"fl_x": camera.focal, "fl_y": camera.focal, "cx": x, "cy": y}


def read_transforms(path: Path) -> SceneViews:
    """Read the frames as training views.

    A view's name is the frame's ``name``, or the name of its image file.

    Raises
    ------
    UserError: the file is missing or has no frames; or a camera is not a pinhole camera with square
        pixels and its axis through the centre of the image; or the images differ in aspect ratio,
        or their size is given neither by the file nor by the images themselves.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise UserError(str(path), "does not exist", "Check the path.") from None
    except (OSError, ValueError, RecursionError) as error:
        raise UserError(str(path), f"is not a JSON file ({error})", "Check the file.") from error
    frames = content.get("frames") if isinstance(content, dict) else None
    if not isinstance(frames, list) or not frames:
        raise UserError(str(path), "has no frames", "Give it a list `frames` of cameras.")
    names: set[str] = set()
    views, aspects = [], []
    for number, frame in enumerate(frames):
        where = f"{path}: frames[{number}]"
        if not isinstance(frame, dict):
            raise UserError(where, f"is {frame!r}, not an object", "Correct the frame.")
        try:
            view, aspect = _read_frame(where, {**content, **frame}, names, path.parent)
        except (TypeError, ValueError, ArithmeticError) as error:
            raise UserError(
                where, f"has a value that is not a usable number: {error}", "Correct the frame."
            ) from error
        names.add(view.name)
        views.append(view)
        aspects.append(aspect)
    if max(aspects) > 1.001 * min(aspects):
        raise UserError(
            str(path), "has images with different aspect ratios", "Use one file per ratio."
        )
    try:
        return SceneViews(aspect=round(aspects[0], 6), views=ViewSets(train=tuple(upright(views))))
    except ValidationError as error:
        raise explain(str(path), SceneViews, error) from error


def read_cameras(path: Path) -> SceneViews:
    """Read the views of a ``transforms.json`` or ``views.yaml``, depending on the file's suffix."""
    return read_transforms(path) if path.suffix == ".json" else read_views(path)


def read_sensors(path: Path, rows: int) -> tuple[list[mi.Sensor], float | None]:
    """Sensors for the training and novel views of a file, with ``rows`` rows of pixels, and the
    file's exposure, if given."""
    read = read_cameras(path)
    sensors = [make_sensor(view, *read.size(rows)) for view in (*read.train, *read.novel)]
    return sensors, read.given_exposure


def _read_frame(
    where: str, frame: Mapping[str, Any], taken: set[str], folder: Path
) -> tuple[View, float]:
    """The view of a frame, and its width divided by its height."""
    matrix = np.array(frame.get("transform_matrix", ()), dtype=float)
    if matrix.shape not in ((4, 4), (3, 4)) or not np.isfinite(matrix).all():
        raise UserError(
            where, "has no transform_matrix of 4 rows", "Give the camera-to-world matrix, 4×4."
        )
    rotation = matrix[:3, :3] / np.linalg.norm(matrix[:3, :3], axis=0)
    if np.abs(rotation.T @ rotation - np.eye(3)).max() > 1e-3 or np.linalg.det(rotation) < 0:
        raise UserError(where, "has a transform_matrix that is not a rotation", "Correct it.")
    if bent := [key for key in _DISTORTIONS if frame.get(key)]:
        raise UserError(
            where, f"has lens distortion ({', '.join(bent)})", "Undistort the images first."
        )
    width, height = _image_size(frame, folder)
    if not (width > 0 and height > 0):
        raise UserError(where, "has no image size", "Give `w` and `h` in pixels.")
    centre = float(frame.get("cx", width / 2)), float(frame.get("cy", height / 2))
    shift = (round(0.5 - centre[0] / width, 9), round(0.5 - centre[1] / height, 9))
    if "fl_x" in frame:
        focal = float(frame["fl_x"])
        if abs(float(frame.get("fl_y", focal)) / focal - 1) > 1e-3:
            raise UserError(where, "has non-square pixels", "Resample the images.")
        fov = 2 * math.atan(width / 2 / focal)
    elif "camera_angle_x" in frame:
        fov = float(frame["camera_angle_x"])
    else:
        raise UserError(where, "has no focal length", "Give `fl_x`, or `camera_angle_x`.")
    text = str(frame.get("name") or Path(str(frame.get("file_path", ""))).stem)
    origin, back, up = matrix[:3, 3], rotation[:, 2], rotation[:, 1]
    try:
        view = View(
            name=name_view(text, taken, otherwise="view"),
            origin=tuple(origin.tolist()),
            target=tuple((origin - back).tolist()),
            up=tuple(up.tolist()),
            fov=math.degrees(fov),
            shift=shift,
        )
    except ValidationError as error:
        raise UserError(where, error.errors()[0]["msg"], "Correct the frame.") from error
    return view, width / height


def _image_size(frame: Mapping[str, Any], folder: Path) -> tuple[float, float]:
    """Width and height in pixels: as given, or those of the image, as in NeRF data sets; 0 if
    neither is available."""
    if "w" in frame or "h" in frame:
        return float(frame.get("w", 0)), float(frame.get("h", 0))
    name = str(frame.get("file_path", ""))
    for file in (folder / name, folder / f"{name}.png") if name else ():
        if file.is_file():
            try:
                with Image.open(file) as opened:
                    return opened.size
            except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
                raise UserError(
                    str(file),
                    f"cannot be read ({error})",
                    "Give `w` and `h` in the frame.",
                ) from error
    return 0, 0

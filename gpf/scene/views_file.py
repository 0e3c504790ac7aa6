"""Write ``views.yaml``, one view per line."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from gpf.core.files import write_text
from gpf.scene.views import CameraPath, Keyframe, SceneViews, View


def write_views(file: Path, views: SceneViews, comment: str = "") -> None:
    """Write a file that :func:`gpf.scene.views.read_views` reads.

    Numbers have nine significant digits. ``comment`` becomes the first line.
    """
    lines = [f"# {comment}"] if comment else []
    lines += [f"exposure: {views.exposure:.9g}", f"aspect: {views.aspect:.9g}"]
    lines += [f"fov_axis: {views.fov_axis}", "views:"]
    axis = views.fov_axis
    lines += [*_list("train", views.views.train, axis), *_list("novel", views.views.novel, axis)]
    if views.views.more:
        lines += _list("more", views.views.more, axis)
    if views.path is not None:
        lines += _path(views.path)
    write_text(file, "\n".join(lines) + "\n")


def _path(path: CameraPath) -> list[str]:
    closed = str(path.closed).lower()
    lines = ["path:", f"  frames: {path.frames}", f"  closed: {closed}"]
    return [*lines, *_list("keyframes", path.keyframes)]


def _list(name: str, cameras: Iterable[Keyframe], axis: str = "x") -> list[str]:
    lines = [f"    - {_camera(camera, axis)}" for camera in cameras]
    return [f"  {name}:", *lines] if lines else [f"  {name}: []"]


def _camera(camera: Keyframe, axis: str) -> str:
    """One camera; ``axis`` is the file's ``fov_axis``, which is not repeated."""
    parts = [f"name: {_word(camera.name)}"] if isinstance(camera, View) else []
    parts += [f"{key}: {_vector(getattr(camera, key))}" for key in ("origin", "target")]
    if camera.up != (0, 1, 0):
        parts.append(f"up: {_vector(camera.up)}")
    parts.append(f"fov: {camera.fov:.9g}")
    if any(camera.shift):
        parts.append(f"shift: {_vector(camera.shift)}")
    if isinstance(camera, View) and "fov_axis" in camera.model_fields_set:
        parts += [f"fov_axis: {camera.fov_axis}"] if camera.fov_axis != axis else []
    return f"{{{', '.join(parts)}}}"


def _word(name: str) -> str:
    """A name, in quotes if YAML would read it as a number, a boolean or null."""
    plain = name[0].isalpha() and name not in ("true", "false", "null")
    return name if plain else f'"{name}"'


def _vector(values: Iterable[float]) -> str:
    return f"[{', '.join(f'{value:.9g}' for value in values)}]"

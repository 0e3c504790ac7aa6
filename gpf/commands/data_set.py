"""Pictures as a data set for view synthesis: cameras, depth, normals and points on the surfaces.

A folder with ``transforms.json`` can be read by nerfstudio and by software that follows its
conventions:

- ``file_path``: the picture, PNG;
- ``depth_file_path``: ``.npy``, (H, W) float32, thousandths of a world unit along the camera's
  axis; 0 where there is no surface;
- ``normal_file_path``: PNG with (n + 1) / 2, n the shading normal in world space; black where there
  is no surface;
- ``time``: of a frame of an animation, from 0 to 1, as in D-NeRF's data sets;
- ``ply_file_path``: points on the surfaces with the colours of the pictures, from which the
  optimisation of Gaussian splats can start.

Depth and normals belong to the surface in the middle of each pixel. At edges, means over pixels
would lie on no surface.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from PIL import Image

from gpf.core.files import write_atomically
from gpf.core.ply import write_ply
from gpf.core.structs import to_numpy
from gpf.scene.pinhole import make_pinhole
from gpf.scene.sensors import make_sensor
from gpf.scene.transforms import write_transforms
from gpf.scene.views import View

POINTS = 100_000
"""Largest number of points in the PLY file."""

DEPTH_UNIT = 1e-3
"""World units per unit of a depth file; the default of nerfstudio."""


def find_layers(
    scene: mi.Scene, view: View, size: tuple[int, int], layers: Sequence[str]
) -> dict[str, np.ndarray]:
    """The depth and the normals of a view as their files have them, if these are among the layers:
    thousandths of a world unit, (H, W) float32; colours, (H, W, 3) uint8.

    Parameters
    ----------
    size: width and height of the picture, pixels.
    """
    if not {"depth", "normal"} & {*layers}:
        return {}
    depth, normal = pixel_centres(scene, view, size)
    shown = np.where(depth[..., None] > 0, 127.5 * (normal + 1), 0).round().astype(np.uint8)
    units: np.ndarray = (depth / DEPTH_UNIT).astype(np.float32)
    found = {"depth": units, "normal": shown}
    return {name: values for name, values in found.items() if name in layers}


def write_layers(folder: Path, view: View, found: Mapping[str, np.ndarray]) -> None:
    """Write the files of what :func:`find_layers` has found."""
    files = layer_files(folder, view)
    if "depth" in found:
        write_atomically(files["depth"], partial(np.save, arr=found["depth"]))
    if "normal" in found:
        write_atomically(files["normal"], Image.fromarray(found["normal"]).save)


def has_layers(folder: Path, view: View, layers: Sequence[str]) -> bool:
    """Whether the files of those of :func:`find_layers` that are wanted exist."""
    return all(file.exists() for file in _wanted_files(folder, view, layers).values())


def write_data_set(
    folder: Path,
    views: Sequence[View],
    size: tuple[int, int],
    layers: Sequence[str],
    times: Mapping[str, float],
) -> None:
    """Write ``transforms.json`` for the pictures of a folder and the files of
    :func:`write_layers`, and points on the surfaces if these have depth.

    Parameters
    ----------
    times: of views of an animation, from 0 to 1, by their names.
    """
    files: dict[str, dict[str, Any]] = {}
    for view in views:
        files[view.name] = {"file_path": f"{view.name}.png"}
        wanted = _wanted_files(folder, view, layers)
        files[view.name] |= {f"{name}_file_path": file.name for name, file in wanted.items()}
        if view.name in times:
            files[view.name]["time"] = times[view.name]
    shared = {}
    if "depth" in layers:
        points, colours = _collect_points(folder, views, size)
        write_ply(folder / "points.ply", {"x y z": points, "red green blue": colours})
        shared["ply_file_path"] = "points.ply"
    write_transforms(folder / "transforms.json", views, size, files, shared)


def _wanted_files(folder: Path, view: View, layers: Sequence[str]) -> dict[str, Path]:
    return {name: file for name, file in layer_files(folder, view).items() if name in layers}


def layer_files(folder: Path, view: View) -> dict[str, Path]:
    """The files for the depth and the normals of a view."""
    return {
        "depth": folder / f"{view.name}_depth.npy",
        "normal": folder / f"{view.name}_normal.png",
    }


def pixel_centres(
    scene: mi.Scene, view: View, size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """The first surface in the middle of each pixel: its depth along the camera's axis, world
    units, (H, W), and its shading normal, (H, W, 3); 0 without a surface."""
    width, height = size
    index = dr.arange(mi.UInt32, width * height)
    place = (mi.Point2f(index % width, index // width) + 0.5) / mi.Point2f(width, height)
    ray, _ = make_sensor(view, width, height).sample_ray(0.0, 0.5, place, mi.Point2f(0.5))
    si = scene.ray_intersect(mi.Ray3f(ray))
    camera = make_pinhole(view, size)
    ahead = mi.Vector3f(*(float(x) for x in camera.rotation[:, 2]))
    origin = mi.Point3f(*(float(x) for x in camera.origin))
    depth = dr.select(si.is_valid(), dr.dot(si.p - origin, ahead), 0)
    normal = dr.select(si.is_valid(), mi.Vector3f(si.sh_frame.n), 0)
    return to_numpy(depth).reshape(height, width), to_numpy(normal).reshape(height, width, 3)


def _collect_points(
    folder: Path, views: Sequence[View], size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Points of all views, world units, (N, 3), and their colours, (N, 3) uint8."""
    each = max(1, POINTS // len(views))
    rng = np.random.default_rng(0)
    points, colours = [], []
    for view in views:
        depth = np.load(folder / f"{view.name}_depth.npy") * DEPTH_UNIT
        with Image.open(folder / f"{view.name}.png") as picture:
            shown = np.asarray(picture.convert("RGB"))
        rows, columns = np.nonzero(depth)
        chosen = rng.permutation(len(rows))[:each]
        rows, columns = rows[chosen], columns[chosen]
        camera = make_pinhole(view, size)
        ahead = np.stack(
            [
                (columns + 0.5 - camera.centre[0]) / camera.focal,
                (rows + 0.5 - camera.centre[1]) / camera.focal,
                np.ones(len(rows)),
            ],
            axis=1,
        )
        points.append(camera.origin + depth[rows, columns, None] * (ahead @ camera.rotation.T))
        colours.append(shown[rows, columns])
    return np.concatenate(points), np.concatenate(colours)

"""Reading and rendering of Gaussians that a network predicted."""

from __future__ import annotations

import math
import zipfile
from dataclasses import dataclass, replace
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.spatial.transform import Rotation

from baselines.protocol import CannotServe
from baselines.splatting.compositing import Compositor
from baselines.splatting.projection import Projector, SplatArrays, project
from baselines.splatting.tiles import sort_into_tiles
from gpf.core.structs import from_numpy
from gpf.scene.pinhole import Pinhole

DEGREE = 3
"""Highest degree of the spherical harmonics that are rendered."""


@dataclass(frozen=True)
class Prediction:
    """A network's prediction from K images.

    Attributes
    ----------
    means (N, 3), covariances (N, 3, 3), opacities (N,): the Gaussians.
    harmonics: spherical harmonics of their colours, (N, 3, D), with D = 1, 4, 9, ... coefficients
        for each channel.
    poses: camera to world, (K, 4, 4); camera axes: x to the right, y down, z ahead.
    intrinsics: (K, 3, 3), in units of the images' width and height.
    background: its colour, (3,).
    seconds, device: time and device of the network's run.
    """

    means: np.ndarray
    covariances: np.ndarray
    harmonics: np.ndarray
    opacities: np.ndarray
    poses: np.ndarray
    intrinsics: np.ndarray
    background: np.ndarray
    seconds: float
    device: str


def read_prediction(file: Path, views: int) -> Prediction:
    """Read what ``programs/infer_with_anysplat.py`` wrote.

    Raises
    ------
    CannotServe: the file has unexpected arrays or shapes, non-finite values, or no Gaussians.
    """
    todo = f"Delete {file} and try again, or use the current version of the published code."
    try:
        with file.open("rb") as opened, np.load(opened) as stored:
            found = {name: stored[name] for name in stored.files}
    except (OSError, ValueError, zipfile.BadZipFile) as error:
        raise CannotServe(str(file), f"is not a file of arrays ({error})", todo) from error
    count = len(found.get("means", ()))
    coefficients = found["harmonics"].shape[-1] if "harmonics" in found else 0
    shapes = {
        "means": (count, 3),
        "covariances": (count, 3, 3),
        "harmonics": (count, 3, coefficients),
        "opacities": (count,),
        "poses": (views, 4, 4),
        "intrinsics": (views, 3, 3),
        "background": (3,),
    }
    for name, shape in shapes.items():
        there = found[name].shape if name in found else None
        if there != shape:
            raise CannotServe(str(file), f"{name}: {there}, where {shape} was expected", todo)
        if not np.isfinite(found[name]).all():
            raise CannotServe(str(file), f"{name} has NaN or infinite values", todo)
    if count == 0:
        raise CannotServe(str(file), "has no Gaussians", todo)
    arrays = {name: found[name].astype(np.float64) for name in shapes}
    return Prediction(**arrays, seconds=float(found["seconds"]), device=str(found["device"]))


def make_splats(found: Prediction) -> SplatArrays:
    """The Gaussians as the parameters that the rasteriser takes."""
    variances, axes = np.linalg.eigh(found.covariances)
    axes[:, :, 0] *= np.sign(np.linalg.det(axes))[:, None]  # rotations, not reflections
    scales = np.sqrt(np.maximum(variances, 1e-20))
    quats = Rotation.from_matrix(axes).as_quat()[:, [3, 0, 1, 2]]
    opacities = np.clip(found.opacities, 1e-6, 1 - 1e-6)
    harmonics = found.harmonics[:, :, : (DEGREE + 1) ** 2].transpose(0, 2, 1)

    def flat(values: np.ndarray) -> mi.Float:
        return from_numpy(mi.Float, values.ravel())

    return SplatArrays(
        means=flat(found.means),
        log_scales=flat(np.log(scales)),
        quats=flat(quats),
        opacities=flat(np.log(opacities / (1 - opacities))),
        colours=flat(harmonics[:, :1]),
        harmonics=flat(harmonics[:, 1:]),
    )


def draw(splats: SplatArrays, camera: Pinhole, background: np.ndarray) -> np.ndarray:
    """The image of splats in front of a background, (H, W, 3) float64."""
    others = dr.width(splats.harmonics) // dr.width(splats.opacities) // 3
    degree = math.isqrt(1 + others) - 1
    image = _composite(splats, camera, degree)
    # Without colour coefficients all splats are grey ½: twice their image is the total opacity.
    nothing = dr.zeros(mi.Float, dr.width(splats.colours))
    hidden = 2 * _composite(replace(splats, colours=nothing), camera, 0)
    return image + (1 - hidden) * background


def _composite(splats: SplatArrays, camera: Pinhole, degree: int) -> np.ndarray:
    width, height = camera.size
    found = project(splats, Projector.of(camera), degree)
    image = Compositor(found, sort_into_tiles(found, camera.size)).image()
    return np.array(image, dtype=np.float64).reshape(height, width, 3)

"""What a page can look at: the picture, its layers, and the Gaussians and photons themselves."""

from __future__ import annotations

import dataclasses
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.structs import to_numpy
from gpf.field.field import GaussianPhotonField
from gpf.photons.tracing import PathSettings, record_photons
from gpf.rendering.aovs import MOST_COVERAGE
from gpf.rendering.denoiser import GUIDES
from gpf.scene.pinhole import make_pinhole
from gpf.scene.views import Keyframe, View
from gpf.viewing.messages import Layer
from gpf.viewing.screen import false_colours, to_display

# Gaussians are shown at this fraction of their size, so that each can be seen by itself.
_SHOWN_SIZE = 0.35

# Photon paths whose photons are shown.
_SHOWN_PATHS = 20_000

# Largest relative error in the false colours.
_LARGEST_ERROR = 0.1

# Largest coverage in the false colours: where the search for Gaussians ends.
_FARTHEST = 4.0


def aovs_of(layer: Layer, guides: bool) -> str:
    """The AOVs that a layer needs; with ``guides``, also those of the denoiser."""
    if layer == "normal":
        return "visible_normal"
    if layer in ("irradiance", "albedo", "depth", "coverage", "error"):
        return layer
    return ",".join(GUIDES) if guides and layer == "image" else ""


def display(layer: Layer, image: np.ndarray, exposure: float, curve: str) -> np.ndarray:
    """Display values (H, W, 3) uint8 of an image (H, W, C) with radiance and the layer's AOVs."""
    if layer == "irradiance":
        return to_display(image[..., 3:6] / np.float32(np.pi), exposure, curve)
    if layer == "albedo":
        return to_display(image[..., 3:6], 1.0)
    if layer == "normal":
        shown: np.ndarray = np.clip(image[..., 3:6] * 127.5 + 127.5, 0, 255).astype(np.uint8)
        return shown
    if layer == "depth":
        return false_colours(image[..., 3], 0.0, float(image[..., 3].max()))
    if layer == "coverage":
        pixels = false_colours(image[..., 3], 1.0, _FARTHEST)
        pixels[image[..., 3] > 1e-3 * MOST_COVERAGE] = 0
        return pixels
    if layer == "error":
        return false_colours(image[..., 3], 0.0, _LARGEST_ERROR)
    return to_display(image[..., :3], exposure, curve)


def as_ellipses(field: GaussianPhotonField) -> GaussianPhotonField:
    """A field that shows each Gaussian by itself, as a spot with its colour."""
    gaussians = dataclasses.replace(
        field.gaussians, log_scales=field.gaussians.log_scales + float(np.log(_SHOWN_SIZE))
    )
    settings = field.settings.model_copy(update={"blend": "sum", "neighbours": "radius"})
    return GaussianPhotonField(
        gaussians, settings, field.bounds, field.record, field.detail, limits=field.limits
    )


class PhotonPoints:
    """Some photons, to be drawn as points."""

    def __init__(self, scene: mi.Scene) -> None:
        self._scene = scene
        photons = record_photons(scene, PathSettings(_SHOWN_PATHS), seed=1)
        self._place: Any = photons.p
        power = to_numpy(photons.power)
        self._colour = np.round(255 * power / power.max(axis=1, keepdims=True).clip(1e-12))

    def draw(self, camera: Keyframe, size: tuple[int, int]) -> np.ndarray:
        """Display values (H, W, 3) uint8 of the photons that the camera sees."""
        width, height = size
        pinhole = make_pinhole(View(name="photons", **camera.model_dump()), size)
        places, depth = pinhole.project(to_numpy(self._place).astype(np.float64))
        inside = (
            (depth > 0) & (places >= 0).all(axis=1) & (places < np.subtract(size, 1)).all(axis=1)
        )
        shown = np.flatnonzero(inside & ~self._hidden(pinhole.origin))
        x, y = places[shown].astype(int).T
        pixels = np.zeros((height, width, 3), np.uint8)
        for dx, dy in ((0, 0), (1, 0), (0, 1), (1, 1)):
            pixels[y + dy, x + dx] = self._colour[shown]
        return pixels

    def _hidden(self, origin: np.ndarray) -> np.ndarray:
        """Whether a surface is between the camera and each photon, (N,)."""
        start = mi.Point3f(*(float(v) for v in origin))
        ray = mi.Ray3f(start, self._place - start)
        ray.maxt = dr.full(mi.Float, 0.999, dr.width(self._place))
        return np.array(self._scene.ray_test(ray))

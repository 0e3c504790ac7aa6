"""Frames of one size from a field, recorded so that the camera moves quickly."""

from __future__ import annotations

import io
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from PIL import Image

from gpf.core.images import tone_map
from gpf.scene.sensors import make_sensor
from gpf.scene.views import Keyframe, View

# Rays across a picture that measure depth.
_PROBES = 16

# Entries of the table of a tone curve.
_ENTRIES = 1 << 14


PLACED = ("to_world", "x_fov", "principal_point_offset_x", "principal_point_offset_y")
"""The parameters of a sensor that a camera sets."""


class Screen:
    """A film of one size, and an integrator that fills it; the camera moves freely.

    Parameters
    ----------
    size: width and height, pixels.
    spp: samples per pixel of a frame.
    """

    def __init__(
        self, scene: mi.Scene, integrator: mi.Integrator, size: tuple[int, int], spp: int = 1
    ) -> None:
        self.scene, self.integrator, self.size, self.spp = scene, integrator, size, spp
        start = View(name="start", origin=(0, 0, 1), target=(0, 0, 0), fov=45, fov_axis="x")
        self.sensor = make_sensor(start, *size, spp=spp)
        self._parameters = mi.traverse(self.sensor)
        self.frames = 0

    def frame(self, camera: Keyframe) -> np.ndarray:
        """All channels of one frame, (H, W, C); the camera's ``fov`` is that across x. Each frame
        has its own random numbers."""
        place = mi.ScalarTransform4f().look_at(
            list(camera.origin), list(camera.target), list(camera.up)
        )
        self._parameters["to_world"] = mi.Transform4f(place)
        self._parameters["x_fov"] = mi.Float(camera.fov)
        for axis, shift in zip("xy", camera.shift, strict=True):
            self._parameters[f"principal_point_offset_{axis}"] = mi.Float(shift)
        # Plain values would be baked into the recorded kernels.
        dr.make_opaque(*(self._parameters[key] for key in PLACED))
        self._parameters.update()
        image = mi.render(
            self.scene,
            sensor=self.sensor,
            integrator=self.integrator,
            spp=self.spp,
            seed=self.frames,
        )
        self.frames += 1
        return np.array(image)

    def depth(self) -> float:
        """The median distance along the axis of what the last frame shows in its middle ninth or,
        if there is no surface, in all of it; 0 if it shows none."""
        index = dr.arange(mi.UInt32, _PROBES**2)
        place = (mi.Point2f(index % _PROBES, index // _PROBES) + 0.5) / _PROBES - 0.5
        ahead = self.sensor.world_transform() @ mi.Vector3f(0, 0, 1)
        for share in (1 / 3, 1.0):
            ray, _ = self.sensor.sample_ray(0.0, 0.5, dr.opaque(mi.Float, share) * place + 0.5, 0.5)
            depth = np.array(self.scene.ray_intersect_preliminary(ray).t * dr.dot(ray.d, ahead))
            if np.isfinite(depth).any():
                return float(np.median(depth[np.isfinite(depth)]))
        return 0.0


@dataclass
class Accumulated:
    """The mean of frames of a camera that does not move."""

    total: np.ndarray | None = None
    frames: int = 0
    seconds: float = 0.0

    def add(self, frame: np.ndarray, seconds: float = 0.0) -> None:
        """Add a frame, (…, H, W, C), and the time that it took."""
        self.total = frame.copy() if self.total is None else self.total + frame
        self.frames += 1
        self.seconds += seconds

    def mean(self) -> np.ndarray:
        """The mean of the frames, (…, H, W, C)."""
        assert self.total is not None
        return self.total / np.float32(self.frames)


def _curve(kind: str) -> np.ndarray:
    """Display values, 0 to 255, at equal steps of x / (1 + x), where x is linear."""
    share = np.linspace(0, 1, _ENTRIES)
    linear = share if kind == "soft" else np.minimum(share / np.maximum(1 - share, 1e-9), 1)
    return np.round(255 * tone_map(linear, 1.0)).astype(np.uint8)


_CURVES = {kind: _curve(kind) for kind in ("srgb", "soft")}


def to_display(radiance: np.ndarray, exposure: float, curve: str = "srgb") -> np.ndarray:
    """Display values (H, W, 3) uint8 of linear radiance, in sRGB; ``soft`` compresses bright light
    as x / (1 + x), and ``srgb`` clips it."""
    x = np.maximum(radiance * np.float32(exposure), 0)
    place: np.ndarray = np.nan_to_num(x / (1 + x), nan=1.0) * np.float32(_ENTRIES - 1)
    return _CURVES[curve][(place + np.float32(0.5)).astype(np.uint16)]


# A few colours of the map `viridis`, by van der Walt and Smith (CC0).
_VIRIDIS = np.array(
    [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]], np.float32
)


def false_colours(value: np.ndarray, least: float, most: float) -> np.ndarray:
    """Display values (H, W, 3) uint8 for one number per pixel, (H, W)."""
    place = np.clip((value - least) / max(most - least, 1e-9), 0, 1) * (len(_VIRIDIS) - 1)
    stops = np.arange(len(_VIRIDIS))
    channels = [np.interp(place, stops, _VIRIDIS[:, c]) for c in range(3)]
    return np.stack(channels, axis=-1).astype(np.uint8)


def encode(pixels: np.ndarray, quality: int) -> bytes:
    """The pixels as a JPEG."""
    out = io.BytesIO()
    subsampling: Any = 0 if quality >= 90 else 2
    Image.fromarray(pixels).save(out, "JPEG", quality=quality, subsampling=subsampling)
    return out.getvalue()

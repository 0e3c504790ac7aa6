"""Views as pinhole cameras in the computer-vision convention: x right, y down, z forward."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gpf.core.vectors import normalise
from gpf.scene.views import View


@dataclass(frozen=True)
class Pinhole:
    """A camera with square pixels.

    Attributes
    ----------
    origin: position, world units, (3,).
    rotation: camera to world, (3, 3); its columns point right, down and forward.
    focal: focal length, pixels.
    size: width and height of the image, pixels.
    centre: where the axis passes through the image, pixels from its upper left corner.
    """

    origin: np.ndarray
    rotation: np.ndarray
    focal: float
    size: tuple[int, int]
    centre: tuple[float, float]

    @property
    def pose(self) -> np.ndarray:
        """Camera to world, (4, 4)."""
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = self.rotation, self.origin
        return matrix

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pixel coordinates (N, 2) and depths (N,) of points (N, 3).

        The first pixel spans 0 to 1. Points behind the camera have negative depths and
        meaningless pixel coordinates.
        """
        x, y, z = ((points - self.origin) @ self.rotation).T
        with np.errstate(divide="ignore", invalid="ignore"):
            pixels = np.stack([self.focal * x / z, self.focal * y / z], axis=1)
        return pixels + np.array(self.centre), z


def make_pinhole(view: View, size: tuple[int, int]) -> Pinhole:
    """The camera of a view; its pixels are those of :func:`gpf.scene.sensors.make_sensor`."""
    origin = np.array(view.origin, dtype=float)
    ahead = normalise(np.array(view.target) - origin)
    right = normalise(np.cross(ahead, view.up))
    rotation = np.stack([right, np.cross(ahead, right), ahead], axis=1)
    x, y = (n * (0.5 - shift) for n, shift in zip(size, view.shift, strict=True))
    return Pinhole(origin, rotation, find_focal(view, size), size, (x, y))


def find_focal(view: View, size: tuple[float, float]) -> float:
    """Focal length in pixels: e / (2 tan(fov / 2)), with the extent e along ``fov_axis``."""
    width, height = size
    extents = {
        "x": width,
        "y": height,
        "diagonal": math.hypot(width, height),
        "smaller": min(size),
        "larger": max(size),
    }
    return extents[view.fov_axis] / 2 / math.tan(math.radians(view.fov) / 2)

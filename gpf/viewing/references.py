"""The references of a scene's cameras, with which the viewer compares its pictures."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from gpf.core.images import read_exr, tone_map
from gpf.core.vectors import normalise
from gpf.scene.views import Keyframe, View


class References:
    """References of some cameras; ``files``: each camera with the EXR file of its reference."""

    def __init__(self, files: Iterable[tuple[View, Path]] = ()) -> None:
        self._images = [(camera, read_exr(file)[0]["radiance"]) for camera, file in files]

    @property
    def rows(self) -> int:
        """Height of the references, pixels; 0 without any."""
        return max((len(image) for _, image in self._images), default=0)

    def of(self, camera: Keyframe) -> np.ndarray | None:
        """The reference of a camera, (H, W, 3), if there is one."""
        return next((image for known, image in self._images if same_place(known, camera)), None)

    def psnr(self, camera: Keyframe, image: np.ndarray, exposure: float) -> float | None:
        """The PSNR of a camera's image (H, W, C), dB; None without a reference of its size."""
        reference = self.of(camera)
        if reference is None or reference.shape[:2] != image.shape[:2]:
            return None
        shown = (tone_map(i, exposure) for i in (reference, image[..., :3]))
        return float(-10 * np.log10(max(np.mean(np.square(np.subtract(*shown))), 1e-10)))


def same_place(one: Keyframe, other: Keyframe) -> bool:
    """Whether two cameras make the same picture."""
    ahead = [np.subtract(camera.target, camera.origin) for camera in (one, other)]
    first, second = (normalise(way) for way in ahead)
    return (
        np.allclose(one.origin, other.origin, atol=1e-5)
        and np.allclose(first, second, atol=1e-5)
        and np.allclose((one.fov, *one.shift), (other.fov, *other.shift), atol=1e-3)
    )

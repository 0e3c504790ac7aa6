"""The references of a scene's cameras, with which the viewer compares its pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from gpf.core.images import read_exr, tone_map
from gpf.scene.views import Keyframe, View
from gpf.viewing.shown import same_place


class References:
    """References by the names of their cameras.

    Parameters
    ----------
    cameras: the scene's cameras; the list may grow.
    files: EXR files by the names of their cameras.
    """

    def __init__(self, cameras: Sequence[View], files: Mapping[str, Path]) -> None:
        self._cameras = cameras
        self._images = {name: read_exr(file)[0]["radiance"] for name, file in files.items()}

    @property
    def rows(self) -> int:
        """Height of the references, pixels; 0 without any."""
        return max((len(image) for image in self._images.values()), default=0)

    def of(self, camera: Keyframe) -> np.ndarray | None:
        """The reference of a camera, (H, W, 3), if there is one."""
        names = (known.name for known in self._cameras if same_place(known, camera))
        return next((self._images[name] for name in names if name in self._images), None)

    def psnr(self, camera: Keyframe, image: np.ndarray, exposure: float) -> float | None:
        """The PSNR of a camera's image (H, W, C), dB; None without a reference of its size."""
        reference = self.of(camera)
        if reference is None or reference.shape[:2] != image.shape[:2]:
            return None
        shown = (tone_map(i, exposure) for i in (reference, image[..., :3]))
        return float(-10 * np.log10(max(np.mean(np.square(np.subtract(*shown))), 1e-10)))

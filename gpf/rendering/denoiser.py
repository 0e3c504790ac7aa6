"""A denoiser: Intel's Open Image Denoise, through the package ``pyoidn``."""

from __future__ import annotations

import importlib.util
from typing import Any, Literal

import numpy as np

from gpf.core.errors import UserError

PACKAGE = "pyoidn==2.5.1"

GUIDES = ("albedo", "visible_normal")
"""The AOVs that guide the denoiser."""

Quality = Literal["fast", "balanced", "high"]


def available() -> bool:
    """Whether the package is installed."""
    return importlib.util.find_spec("pyoidn") is not None


class ImageDenoiser:
    """Denoises images of one size; its networks are built once.

    The filter is ``RT`` in HDR mode with ``cleanAux``: guides count as free of noise. Noisy guides
    are denoised first, each by itself, as the library's manual recommends for final images.

    Parameters
    ----------
    size: width and height, pixels.
    prefilter: whether the guides have noise.
    cuda: whether to use a GPU if the library finds one.
    quality: of all filters.

    Raises
    ------
    UserError: the package is missing, or the library does not run on this machine.
    """

    def __init__(
        self,
        size: tuple[int, int],
        prefilter: bool,
        cuda: bool = False,
        quality: Quality = "high",
    ) -> None:
        self._oidn = oidn = _import()
        try:
            gpu = cuda and bool(oidn.Device.is_cuda_available())
        except OSError as error:  # the package loads the library at its first use
            raise UserError(
                "Open Image Denoise", f"does not load: {error}", f"pip install {PACKAGE}"
            ) from error
        kind = oidn.OIDN_DEVICE_TYPE_CUDA if gpu else oidn.OIDN_DEVICE_TYPE_CPU
        self._device = oidn.Device(kind)
        self._device.commit()
        self._check()
        self.description = (
            f"Open Image Denoise {oidn.version.oidn_version}, {'CUDA' if gpu else 'CPU'}"
        )
        self._size, self._quality = size, getattr(oidn, f"OIDN_QUALITY_{quality.upper()}")
        self._images = {
            name: oidn.Buffer(self._device, size[0] * size[1] * 12)
            for name in ("color", "albedo", "normal", "output")
        }
        guides = ("albedo", "normal") if prefilter else ()
        self._filters = [self._make_filter((guide,), guide) for guide in guides]
        self._filters.append(
            self._make_filter(("color", "albedo", "normal"), "output", hdr=True, cleanAux=True)
        )

    def denoise(self, radiance: np.ndarray, albedo: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """The image without noise; all images are (H, W, 3) float32.

        Raises
        ------
        ValueError: an image has another size.
        """
        for name, image in (("color", radiance), ("albedo", albedo), ("normal", normal)):
            if image.shape != (self._size[1], self._size[0], 3):
                raise ValueError(f"{name} has the shape {image.shape}, for images of {self._size}")
            pixels = np.ascontiguousarray(image, dtype=np.float32)
            self._images[name].write(0, pixels.nbytes, pixels)
        for filter_ in self._filters:
            filter_.execute()
        output = np.empty((self._size[1], self._size[0], 3), np.float32)
        self._images["output"].read(0, output.nbytes, output)
        self._check()
        return output

    def _make_filter(self, inputs: tuple[str, ...], output: str, **switches: bool) -> Any:
        """A filter that is ready to run; its output may be one of its inputs."""
        oidn = self._oidn
        made = oidn.Filter(self._device, oidn.OIDN_FILTER_TYPE_RT)
        for role, name in [*zip(inputs, inputs, strict=True), ("output", output)]:
            made.set_image(role, self._images[name], oidn.OIDN_FORMAT_FLOAT3, *self._size)
        for name, value in switches.items():
            made.set_bool(name, value)
        made.set_quality(self._quality)
        made.commit()
        self._check()
        return made

    def _check(self) -> None:
        if message := self._device.get_error():
            raise UserError(
                "Open Image Denoise", message, "Leave denoising out, or try another machine."
            )


def _import() -> Any:
    try:
        import pyoidn
    except ImportError as error:
        raise UserError(
            "pyoidn", f"package not installed: {PACKAGE} ({error})", f"pip install {PACKAGE}"
        ) from error
    return pyoidn

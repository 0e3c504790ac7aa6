"""Denoising with Intel's Open Image Denoise, through the package ``pyoidn``."""

from __future__ import annotations

import importlib.util
from typing import Any, Literal

import numpy as np
from scipy.ndimage import uniform_filter

from gpf.core.errors import UserError
from gpf.rendering.adaptive import NEIGHBOURHOOD, least_visible

PACKAGE = "pyoidn==2.5.1"

GUIDES = ("albedo", "visible_normal")
"""The AOVs that guide the denoiser."""

NOISE_TRUST = 2
"""The denoiser may change a pixel by this many times the estimated noise (both squared)."""

LIMIT = 100
"""Largest radiance that the denoiser sees, in medians of the image. Beside a lamp that is a hundred
thousand times as bright as the wall, its rounding errors would be brighter than the wall."""

Quality = Literal["fast", "balanced", "high"]


def available() -> bool:
    """Whether the package is installed."""
    return importlib.util.find_spec("pyoidn") is not None


class ImageDenoiser:
    """Denoises images of one size; its networks are built once.

    The filter is ``RT`` in HDR mode with ``cleanAux``: guides are taken to be noise-free. Noisy
    guides are denoised first, each on its own, as the library's manual recommends for final images.

    Parameters
    ----------
    size: width and height, pixels.
    prefilter: whether the guides are noisy.
    cuda: whether to use a GPU if the library finds one.
    quality: quality of all filters.

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
        self.size, self._quality = size, getattr(oidn, f"OIDN_QUALITY_{quality.upper()}")
        self._images = {
            name: oidn.Buffer(self._device, size[0] * size[1] * 12)
            for name in ("color", "albedo", "normal", "output")
        }
        guides = ("albedo", "normal") if prefilter else ()
        self._prefilters = {guide: self._make_filter((guide,), guide) for guide in guides}
        self._filter = self._make_filter(
            ("color", "albedo", "normal"), "output", hdr=True, cleanAux=True
        )

    def denoise(
        self,
        radiance: np.ndarray,
        albedo: np.ndarray | None = None,
        normal: np.ndarray | None = None,
    ) -> np.ndarray:
        """The image without noise; all images are (H, W, 3) float32. Guides that are left out are
        those of the call before.

        Raises
        ------
        ValueError: an image has another size.
        """
        for name, image in (("color", radiance), ("albedo", albedo), ("normal", normal)):
            if image is None:
                continue
            if image.shape != (self.size[1], self.size[0], 3):
                raise ValueError(
                    f"{name} has the shape {image.shape}; the denoiser has the size {self.size}"
                )
            pixels = np.ascontiguousarray(image, dtype=np.float32)
            self._images[name].write(0, pixels.nbytes, pixels)
            if name in self._prefilters:
                self._prefilters[name].execute()
        self._filter.execute()
        output = np.empty((self.size[1], self.size[0], 3), np.float32)
        self._images["output"].read(0, output.nbytes, output)
        self._check()
        return output

    def _make_filter(self, inputs: tuple[str, ...], output: str, **switches: bool) -> Any:
        """A filter that is ready to run; its output may be one of its inputs."""
        oidn = self._oidn
        made = oidn.Filter(self._device, oidn.OIDN_FILTER_TYPE_RT)
        for role, name in [*zip(inputs, inputs, strict=True), ("output", output)]:
            made.set_image(role, self._images[name], oidn.OIDN_FORMAT_FLOAT3, *self.size)
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


def denoise(
    image: np.ndarray,
    guides: tuple[np.ndarray, np.ndarray],
    variance: np.ndarray | None,
    denoiser: ImageDenoiser,
) -> np.ndarray:
    """The image without its noise; radiance above :data:`LIMIT` stays as it is.

    Parameters
    ----------
    image: radiance, (H, W, 3).
    guides: albedo and normals, (H, W, 3) each.
    variance: variance of the image's pixels, (H, W); without it, anything may be noise.
    """
    seen = np.minimum(image, limit := LIMIT * median_lit(image))
    clean = denoiser.denoise(seen, *guides)
    if variance is not None:
        clean = blend(seen, clean, np.minimum(variance, limit**2))
    whole: np.ndarray = clean + (image - seen)
    return whole


def median_lit(image: np.ndarray) -> float:
    """The median of all values that are not black, or 0 if there are none."""
    lit = image[image > 0]
    return float(np.median(lit)) if len(lit) else 0.0


def _least_visible(image: np.ndarray) -> np.ndarray:
    """The visible error of each pixel (:func:`gpf.rendering.adaptive.least_visible`), (H, W)."""
    level = image.mean(axis=2)
    level = np.where(np.isfinite(level), np.maximum(level, 0), 0)
    scale: np.ndarray = least_visible(level, median_lit(level) or 1.0)
    return scale


def blend(image: np.ndarray, denoised: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """The denoised image where noise explains the change; more of the original where the denoiser
    smears what is not noise:

        I + min(1, κ ⟨σ²⟩ / ⟨(D - I)²⟩) (D - I)

    with means over a few pixels around each, in units of what is visible, and κ = NOISE_TRUST.

    Parameters
    ----------
    image, denoised: I and D, (H, W, 3).
    variance: σ² of the image's pixels, (H, W).
    """
    scale = _least_visible(image)
    changed = uniform_filter(((denoised - image) ** 2).mean(axis=2) / scale, NEIGHBOURHOOD)
    noise = uniform_filter(variance / scale, NEIGHBOURHOOD)
    share = np.clip(NOISE_TRUST * noise / np.maximum(changed, 1e-30), 0, 1)
    blended: np.ndarray = image + share[..., None] * (denoised - image)
    return blended


def _import() -> Any:
    try:
        import pyoidn
    except ImportError as error:
        raise UserError(
            "pyoidn", f"package not installed: {PACKAGE} ({error})", f"pip install {PACKAGE}"
        ) from error
    return pyoidn

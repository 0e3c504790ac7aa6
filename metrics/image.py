"""Metrics of a rendered image against its reference.

Images are arrays ``(H, W, 3)`` of linear radiance, float32 or float64. PSNR, SSIM, LPIPS and
LDR-FLIP compare displayed values (:func:`expose`): radiance times one fixed exposure per scene,
clamped to [0, 1], sRGB encoded, not rounded to 8 bits. relMSE and HDR-FLIP compare the radiance.

All functions raise ``ValueError`` for images that cannot be compared (different shapes, an integer
type, NaN or infinite radiance), and ``MetricUnavailable`` if a package or the network weights are
missing.
"""

from collections.abc import Callable, Sequence
from typing import Any, TypedDict

import numpy as np
from numpy.typing import NDArray

from metrics import flip
from metrics.errors import MetricUnavailable

Image = NDArray[np.floating[Any]]

PSNR_CAP = 100.0
"""Upper limit of PSNR in dB, also for equal images, because JSON has no infinity. It stands
for an RMS error of 1e-5, 1/400 of an 8-bit step."""

SSIM_RADIUS = 5
"""Half of SSIM's window, in pixels."""

SSIM_MINIMUM = SSIM_RADIUS + 1
"""Smallest side in pixels; reflecting ``SSIM_RADIUS`` pixels needs one more."""

LPIPS_MINIMUM = 16
"""Smallest side in pixels; VGG-16 halves the image four times."""

NUMBERS = ("psnr", "ssim", "lpips", "flip", "flip_hdr", "relmse")
"""Names of the metrics in :class:`Comparison`."""


class Comparison(TypedDict):
    """All metrics of one image; for a metric that is ``None``, ``reasons`` says why."""

    psnr: float | None
    ssim: float | None
    lpips: float | None
    flip: float | None
    flip_hdr: float | None
    relmse: float | None
    reasons: dict[str, str]


def expose(image: Image, exposure: float) -> NDArray[np.float64]:
    """Displayed values ``sRGB(clamp(exposure * image, 0, 1))``, (H, W, 3), not rounded.

    ``exposure`` is a factor, not a number of stops.
    """
    _check_image(image, "image")
    if not (np.isfinite(exposure) and exposure > 0):
        raise ValueError(f"exposure is {exposure}; give a finite factor greater than 0")
    linear = np.clip(np.asarray(image, dtype=np.float64) * exposure, 0.0, 1.0)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.power(linear, 1 / 2.4) - 0.055)


def psnr(test: Image, reference: Image, exposure: float) -> float:
    """Peak signal-to-noise ratio of the exposed images, ``min(100, -10 log10(MSE))`` dB."""
    shown, wanted = _expose_pair(test, reference, exposure)
    mse = float(np.mean(np.square(shown - wanted)))
    return PSNR_CAP if mse == 0 else min(PSNR_CAP, float(-10 * np.log10(mse)))


def ssim(test: Image, reference: Image, exposure: float) -> float:
    """Structural similarity of the exposed images, 1 for equal images.

    The settings are the defaults of torchmetrics: a Gaussian window of 11 pixels, sigma 1.5,
    k1 0.01, k2 0.03, data range 1, images reflected at their edges, the mean over all pixels and
    channels. Implementations with other settings differ in the second digit.
    """
    shown, wanted = _expose_pair(test, reference, exposure)
    _check_size(shown, SSIM_MINIMUM, "SSIM")
    try:
        # The same numbers as torchmetrics, 30 times faster, because its window is separable.
        from skimage.metrics import structural_similarity
    except ImportError as error:
        raise MetricUnavailable(
            f"scikit-image cannot be imported ({type(error).__name__}): pip install scikit-image"
        ) from error
    # scikit-image leaves half a window out of the mean at each edge: here, the reflected pixels.
    edges = ((SSIM_RADIUS, SSIM_RADIUS), (SSIM_RADIUS, SSIM_RADIUS), (0, 0))
    first, second = (np.pad(x, edges, mode="reflect") for x in (shown, wanted))
    value: Any = structural_similarity(
        first,
        second,
        data_range=1.0,
        channel_axis=-1,
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
    )
    return float(value)


def lpips(test: Image, reference: Image, exposure: float) -> float:
    """LPIPS (VGG-16, version 0.1) of the exposed images, 0 for equal images."""
    shown, wanted = _expose_pair(test, reference, exposure)
    _check_size(shown, LPIPS_MINIMUM, "LPIPS")
    try:
        from metrics.lpips import distance
    except ImportError as error:
        raise MetricUnavailable(
            f"torch cannot be imported ({type(error).__name__}): pip install torch"
        ) from error
    return distance(shown, wanted)


def flip_ldr(test: Image, reference: Image, exposure: float) -> float:
    """Mean FLIP error of the exposed images at FLIP's default 67 pixels per degree."""
    return flip.evaluate_ldr(*_expose_pair(test, reference, exposure))


def flip_hdr(
    test: Image,
    reference: Image,
    start_exposure: float | None = None,
    stop_exposure: float | None = None,
) -> float:
    """Mean HDR-FLIP error of the linear images; negative radiance counts as 0.

    The exposures are in stops (powers of two). Use the pair from :func:`flip_exposures` for all
    images of a scene; otherwise their numbers cannot be compared. If neither is given, they come
    from this reference. Giving only one of the two is a ``ValueError``.
    """
    _check_pair(test, reference)
    if start_exposure is None and stop_exposure is None:
        start_exposure, stop_exposure = flip_exposures([reference])
    if start_exposure is None or stop_exposure is None:
        raise ValueError("give both start_exposure and stop_exposure, or neither of them")
    return flip.evaluate_hdr(test, reference, start_exposure, stop_exposure)


def flip_exposures(references: Sequence[Image]) -> tuple[float, float]:
    """First and last HDR-FLIP exposure of a scene in stops, from the pixels of all references.

    The references may have different sizes.
    """
    if not references:
        raise ValueError("no reference image was given; HDR-FLIP's exposures depend on them")
    for index, reference in enumerate(references):
        _check_image(reference, f"reference image {index}")
    return flip.choose_exposures(np.concatenate([r.reshape(-1, 3) for r in references]))


def relmse(test: Image, reference: Image, epsilon: float = 0.01) -> float:
    """Relative squared error of the linear images: ``mean((t - r)^2 / (r^2 + epsilon))``."""
    _check_pair(test, reference)
    if not epsilon > 0:
        raise ValueError(f"epsilon is {epsilon}; give a number greater than 0")
    t, r = np.asarray(test, dtype=np.float64), np.asarray(reference, dtype=np.float64)
    return float(np.mean(np.square(t - r) / (np.square(r) + epsilon)))


def compare(
    test: Image,
    reference: Image,
    exposure: float,
    start_exposure: float | None = None,
    stop_exposure: float | None = None,
    epsilon: float = 0.01,
) -> Comparison:
    """All metrics of ``test`` against ``reference``, as JSON values.

    A metric that this machine cannot compute is ``None``, and ``reasons`` has its message.

    Raises
    ------
    ValueError: the images cannot be compared at all.
    """
    _check_pair(test, reference)
    reasons: dict[str, str] = {}

    def measure(name: str, metric: Callable[[], float]) -> float | None:
        try:
            return metric()
        except MetricUnavailable as reason:
            reasons[name] = str(reason)
            return None

    return Comparison(
        psnr=psnr(test, reference, exposure),
        ssim=measure("ssim", lambda: ssim(test, reference, exposure)),
        lpips=measure("lpips", lambda: lpips(test, reference, exposure)),
        flip=measure("flip", lambda: flip_ldr(test, reference, exposure)),
        flip_hdr=measure(
            "flip_hdr", lambda: flip_hdr(test, reference, start_exposure, stop_exposure)
        ),
        relmse=relmse(test, reference, epsilon),
        reasons=reasons,
    )


def unavailable() -> dict[str, str]:
    """Metrics that this machine cannot compute -> reasons.

    All metrics are computed for a ramp of 16x24 pixels. This also finds packages that can be
    imported but do not work.
    """
    ramp = np.linspace(0.0, 1.0, 16 * 24 * 3).reshape(16, 24, 3)
    return compare(0.5 * ramp, ramp, 1.0)["reasons"]


def _expose_pair(
    test: Image, reference: Image, exposure: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    _check_pair(test, reference)
    return expose(test, exposure), expose(reference, exposure)


def _check_pair(test: Image, reference: Image) -> None:
    _check_image(test, "test image")
    _check_image(reference, "reference image")
    if test.shape != reference.shape:
        raise ValueError(
            f"the test image is {_size(test)} pixels and the reference image is "
            f"{_size(reference)}: render both with the same film size"
        )


def _check_image(image: Image, which: str) -> None:
    if image.ndim != 3 or image.shape[2] != 3 or image.size == 0:
        raise ValueError(
            f"the {which} has the shape {image.shape}; an array (H, W, 3) of linear RGB is needed"
        )
    if not np.issubdtype(image.dtype, np.floating):
        raise ValueError(
            f"the {which} is {image.dtype}; linear radiance in float32 or float64 is "
            "needed: read the EXR, not an 8-bit picture of it"
        )
    bad = ~np.isfinite(image).all(axis=2)
    if bad.any():
        row, column = np.argwhere(bad)[0]
        raise ValueError(
            f"the {which} has NaN or infinite radiance in {bad.sum()} of {bad.size} pixels, the "
            f"first at row {row}, column {column}: render it again, and if they remain, check "
            "the materials and lights that these pixels see"
        )


def _check_size(image: Image, minimum: int, metric: str) -> None:
    if min(image.shape[:2]) < minimum:
        raise MetricUnavailable(
            f"{metric} needs at least {minimum}x{minimum} pixels, but the image is "
            f"{_size(image)}: render it larger"
        )


def _size(image: Image) -> str:
    return f"{image.shape[1]}x{image.shape[0]}"

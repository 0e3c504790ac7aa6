"""How far a rendered image is from its reference.

Images are arrays ``(H, W, 3)`` of linear radiance, float32 or float64. PSNR,
SSIM, LPIPS and LDR-FLIP compare what a viewer would see: radiance times one
fixed exposure per scene, clamped to [0, 1], sRGB encoded, never rounded to
8 bits. relMSE and HDR-FLIP compare the radiance itself.

Every function raises ``ValueError`` for images that cannot be compared (another
shape, an integer type, NaN or infinite radiance) and ``MetricUnavailable`` where
a package or the network weights are missing.
"""

from collections.abc import Callable, Sequence
from typing import Any, TypedDict

import numpy as np
from numpy.typing import NDArray

from metrics import flip
from metrics.errors import MetricUnavailable

Image = NDArray[np.floating[Any]]

PSNR_CAP = 100.0
"""The PSNR of equal images in dB, as JSON has no infinity. The RMS error there is
1e-5, a 400th of an 8-bit step: better images need no telling apart."""

SSIM_RADIUS = 5
"""Half of its window, in pixels."""

SSIM_MINIMUM = SSIM_RADIUS + 1
"""Smallest side in pixels of which so many can be reflected."""

LPIPS_MINIMUM = 16
"""Smallest side in pixels that survives the four halvings of VGG-16."""


NUMBERS = ("psnr", "ssim", "lpips", "flip", "flip_hdr", "relmse")
"""What :func:`compare` finds out, by name."""


class Comparison(TypedDict):
    """All metrics of one image; ``None`` where ``reasons`` says why there is no number."""

    psnr: float | None
    ssim: float | None
    lpips: float | None
    flip: float | None
    flip_hdr: float | None
    relmse: float | None
    reasons: dict[str, str]


def expose(image: Image, exposure: float) -> NDArray[np.float64]:
    """Encode linear radiance for display: ``sRGB(clamp(exposure * image, 0, 1))``.

    ``exposure`` is a plain factor, not a number of stops. The result has the
    shape of ``image`` and is not quantised.
    """
    _check_image(image, "image")
    if not (np.isfinite(exposure) and exposure > 0):
        raise ValueError(f"exposure is {exposure}; give a finite factor greater than 0")
    linear = np.clip(np.asarray(image, dtype=np.float64) * exposure, 0.0, 1.0)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.power(linear, 1 / 2.4) - 0.055)


def psnr(test: Image, reference: Image, exposure: float) -> float:
    """Peak signal-to-noise ratio of the exposed images: ``-10 log10(MSE)`` dB.

    At most ``PSNR_CAP`` (100 dB), which is also the answer for equal images.
    """
    shown, wanted = _expose_pair(test, reference, exposure)
    mse = float(np.mean(np.square(shown - wanted)))
    return PSNR_CAP if mse == 0 else min(PSNR_CAP, float(-10 * np.log10(mse)))


def ssim(test: Image, reference: Image, exposure: float) -> float:
    """Structural similarity of the exposed images, 1 for equal ones.

    As torchmetrics has it by default (a Gaussian window of 11 pixels, sigma 1.5, k1 0.01,
    k2 0.03, data range 1, images reflected at their edges, the mean over all pixels and
    channels): other implementations differ in the second digit.
    """
    shown, wanted = _expose_pair(test, reference, exposure)
    _check_size(shown, SSIM_MINIMUM, "SSIM")
    try:
        # Its window is separable: the same numbers in a thirtieth of torchmetrics' time.
        from skimage.metrics import structural_similarity
    except ImportError as error:
        raise MetricUnavailable(
            f"scikit-image cannot be imported ({error}): pip install scikit-image"
        ) from error
    # It leaves half a window out of the mean at each edge: here, what is reflected.
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
    """LPIPS (VGG-16, version 0.1) of the exposed images, 0 for equal ones."""
    shown, wanted = _expose_pair(test, reference, exposure)
    _check_size(shown, LPIPS_MINIMUM, "LPIPS")
    try:
        from metrics.lpips import distance
    except ImportError as error:
        raise MetricUnavailable(f"torch cannot be imported ({error}): pip install torch") from error
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

    The exposures are in stops (powers of two). Give all images of a scene the
    pair from ``flip_exposures``, or their numbers do not compare. With neither,
    they come from this reference alone; only one of them is a ``ValueError``.
    """
    _check_pair(test, reference)
    if start_exposure is None and stop_exposure is None:
        start_exposure, stop_exposure = flip_exposures([reference])
    if start_exposure is None or stop_exposure is None:
        raise ValueError("give both start_exposure and stop_exposure, or neither of them")
    return flip.evaluate_hdr(test, reference, start_exposure, stop_exposure)


def flip_exposures(references: Sequence[Image]) -> tuple[float, float]:
    """First and last HDR-FLIP exposure in stops for a scene, from its reference images.

    The views of a scene may differ in size: their pixels are pooled.
    """
    if not references:
        raise ValueError("no reference image was given: HDR-FLIP's exposures come from them")
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
    """All metrics of ``test`` against ``reference``, ready for JSON.

    A metric that cannot be computed here is ``None``, and ``reasons`` holds the
    words for it; ``reasons`` is empty when all numbers are there. Images that
    cannot be compared at all raise ``ValueError``.
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
    """Which metrics this machine cannot compute, each with its reason; empty if none.

    Found by computing them all on a ramp of 16x24 pixels, so that a package that
    imports but does not work is seen too.
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
            f"first at row {row}, column {column}: render it again, and if the pixels stay, look "
            "at the materials and lights that they see"
        )


def _check_size(image: Image, minimum: int, metric: str) -> None:
    if min(image.shape[:2]) < minimum:
        raise MetricUnavailable(
            f"{metric} needs at least {minimum}x{minimum} pixels and the image is "
            f"{_size(image)}: render it larger"
        )


def _size(image: Image) -> str:
    return f"{image.shape[1]}x{image.shape[0]}"

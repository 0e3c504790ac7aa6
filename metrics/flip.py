"""FLIP through NVIDIA's own evaluator, and the exposures that HDR-FLIP takes.

This file is the adapter: it alone imports ``flip_evaluator``, and only when a
number is asked for. The evaluator ends the whole process when the exposures are
in the wrong order, so that is checked here before it is called.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrics.errors import MetricUnavailable

INSTALL = "pip install --no-deps flip-evaluator==1.7"

_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # Rec. 709
_ACES = (0.9036, 0.018, 0.0, 0.8748, 0.354, 0.14)  # numerator, then denominator, of the curve
_SATURATED = 16.0  # any input from 12.1 up comes out of the curve as white
_BRIGHT = 0.85  # the display value that the brightest and the median luminance are mapped to


def evaluate_ldr(test: NDArray[np.float64], reference: NDArray[np.float64]) -> float:
    """Mean LDR-FLIP error of two sRGB images ``(H, W, 3)`` with values in [0, 1]."""
    return _evaluate(test, reference, "LDR", {})


def evaluate_hdr(
    test: NDArray[Any], reference: NDArray[Any], start_exposure: float, stop_exposure: float
) -> float:
    """Mean HDR-FLIP error of two linear images ``(H, W, 3)``; negative values count as 0.

    The error of a pixel is its largest LDR-FLIP error over the exposures from
    ``start_exposure`` to ``stop_exposure`` (stops), one per stop and at least
    two, each after the ACES tone curve.
    """
    if not (np.isfinite([start_exposure, stop_exposure]).all() and start_exposure <= stop_exposure):
        raise ValueError(
            f"HDR-FLIP's exposures run from {start_exposure} to {stop_exposure}; two finite "
            "numbers of stops are needed, the first not above the second"
        )
    stops = {"startExposure": float(start_exposure), "stopExposure": float(stop_exposure)}
    # What is white at the first exposure is white at all of them. Cutting there changes no
    # error, and keeps the curve's squares from overflowing float32 at a single bright pixel.
    white = _SATURATED * 2.0**-start_exposure
    return _evaluate(np.clip(test, 0, white), np.clip(reference, 0, white), "HDR", stops)


def choose_exposures(pixels: NDArray[Any]) -> tuple[float, float]:
    """First and last exposure in stops for linear reference pixels ``(N, 3)``.

    The rule of the HDR-FLIP paper: with x the input that the ACES curve maps to
    0.85, ``start = log2(x / max Y)`` and ``stop = log2(x / median Y)``, so that
    first the brightest and last the median luminance Y is well exposed. Unlike
    the evaluator, pixels of luminance 0 are left out of the median: one half of
    an image being background would otherwise ask for an exposure of 24 stops.
    Raises ``MetricUnavailable`` if no pixel is lit.
    """
    luminance = np.sort(np.asarray(pixels, dtype=np.float64) @ _LUMINANCE)
    lit = luminance[luminance > 0]
    if lit.size == 0:
        raise MetricUnavailable(
            "the reference is black, so HDR-FLIP has no exposure to start from: "
            "check the scene's lights and render the reference again"
        )
    a, b, c = (_ACES[i] - _BRIGHT * _ACES[i + 3] for i in range(3))
    x = -0.5 * b / a + np.sqrt((0.5 * b / a) ** 2 - c / a)
    return float(np.log2(x / lit[-1])), float(np.log2(x / lit[lit.size // 2]))


def _evaluate(
    test: NDArray[Any], reference: NDArray[Any], dynamic_range: str, stops: dict[str, float]
) -> float:
    try:
        from flip_evaluator import evaluate
    except ImportError as error:
        raise MetricUnavailable(
            f"flip_evaluator cannot be imported ({error}): {INSTALL}"
        ) from error
    first, second = (np.ascontiguousarray(x, dtype=np.float32) for x in (reference, test))
    _, mean, _ = evaluate(
        first, second, dynamic_range, inputsRGB=True, applyMagma=False, parameters=stops
    )
    return float(mean)

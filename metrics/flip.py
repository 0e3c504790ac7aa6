"""FLIP by NVIDIA's evaluator, and the exposures for HDR-FLIP.

Only this file imports ``flip_evaluator``, when the first number is computed. The evaluator ends
the whole process if the exposures are in the wrong order, so their order is checked here first.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrics.errors import MetricUnavailable

INSTALL = "pip install --no-deps flip-evaluator==1.7"

_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # Rec. 709
_ACES = (0.9036, 0.018, 0.0, 0.8748, 0.354, 0.14)  # the tone curve: numerator, denominator
_SATURATED = 16.0  # above the input 12.1, from which on the tone curve gives white
_BRIGHT = 0.85  # display value of the brightest and of the median luminance


def evaluate_ldr(test: NDArray[np.float64], reference: NDArray[np.float64]) -> float:
    """Mean LDR-FLIP error of two sRGB images ``(H, W, 3)`` with values in [0, 1]."""
    return _evaluate(test, reference, "LDR", {})


def evaluate_hdr(
    test: NDArray[Any], reference: NDArray[Any], start_exposure: float, stop_exposure: float
) -> float:
    """Mean HDR-FLIP error of two linear images ``(H, W, 3)``; negative values count as 0.

    The error of a pixel is its largest LDR-FLIP error over the exposures from ``start_exposure``
    to ``stop_exposure`` (in stops), after the ACES tone curve. There is one exposure per stop, and
    at least two.

    Raises
    ------
    ValueError: the exposures are not finite or in the wrong order.
    MetricUnavailable: ``flip_evaluator`` is not installed.
    """
    if not (np.isfinite([start_exposure, stop_exposure]).all() and start_exposure <= stop_exposure):
        raise ValueError(
            f"HDR-FLIP's exposures run from {start_exposure} to {stop_exposure}; give two finite "
            "numbers of stops, the first not above the second"
        )
    stops = {"startExposure": float(start_exposure), "stopExposure": float(stop_exposure)}
    # A pixel that is white at the first exposure is white at all exposures. So this clip changes
    # no error, and the squares of the tone curve do not overflow float32 at a very bright pixel.
    white = _SATURATED * 2.0**-start_exposure
    return _evaluate(np.clip(test, 0, white), np.clip(reference, 0, white), "HDR", stops)


def choose_exposures(pixels: NDArray[Any]) -> tuple[float, float]:
    """First and last exposure in stops for linear reference pixels ``(N, 3)``.

    The rule of the HDR-FLIP paper, where Y is the luminance and x the input that the ACES curve
    maps to 0.85::

        start = log2(x / max Y)
        stop = log2(x / median Y)

    Here the median leaves out pixels with Y = 0; the evaluator's own rule does not. Otherwise an
    image that is half black background would get an exposure of 24 stops.

    Raises
    ------
    MetricUnavailable: all pixels are black.
    """
    luminance = np.sort(np.asarray(pixels, dtype=np.float64) @ _LUMINANCE)
    lit = luminance[luminance > 0]
    if lit.size == 0:
        raise MetricUnavailable(
            "the reference is black, so there are no exposures for HDR-FLIP: "
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
        # The error's text may name a folder of this machine, and the message goes into files.
        kind = type(error).__name__
        raise MetricUnavailable(f"flip_evaluator cannot be imported ({kind}): {INSTALL}") from error
    first, second = (np.ascontiguousarray(x, dtype=np.float32) for x in (reference, test))
    _, mean, _ = evaluate(
        first, second, dynamic_range, inputsRGB=True, applyMagma=False, parameters=stops
    )
    return float(mean)

"""Equivalent passes: how many SPPM passes give the same PSNR as an image."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np


@dataclass(frozen=True)
class EquivalentPasses:
    """A number of passes, or a bound if the PSNR lies outside the measured curve.

    Attributes
    ----------
    bound: ``""`` inside the curve; ``"<"`` for fewer than ``passes``, the curve's first point;
        ``">"`` for more than ``passes``, its last point.
    """

    passes: float
    bound: Literal["", "<", ">"] = ""

    def __str__(self) -> str:
        """``<3``, ``4.5``, ``137`` or ``>1000``."""
        digits = 0 if self.passes >= 10 else 1
        return f"{self.bound}{self.passes:.{digits}f}".removesuffix(".0")


def equivalent_passes(psnr: float, curve: Mapping[int, float]) -> EquivalentPasses:
    """The number of SPPM passes that reach ``psnr`` (dB).

    Between two measured points, log(passes) is linear in PSNR, because the error falls as a power
    of the number of passes. A point that is not better than one with fewer passes is noise; it is
    left out, so that the curve rises strictly. Outside the curve nothing is extrapolated: the
    result is a bound.

    Parameters
    ----------
    curve: number of passes -> measured PSNR in dB; at least one point.

    Raises
    ------
    ValueError: the curve is empty, has a number of passes below 1, or a PSNR is not finite.
    """
    if not curve:
        raise ValueError("the SPPM curve has no point: measure at least one number of passes")
    if min(curve) < 1 or not np.isfinite(list(curve.values())).all():
        raise ValueError(f"the SPPM curve {dict(curve)} needs passes >= 1 and finite PSNRs")
    if not math.isfinite(psnr):
        raise ValueError(f"the PSNR is {psnr}; a finite number of dB is needed")
    passes: list[int] = []
    heights: list[float] = []
    for count in sorted(curve):
        if not heights or curve[count] > heights[-1]:
            passes.append(count)
            heights.append(curve[count])
    if psnr < heights[0]:
        return EquivalentPasses(float(passes[0]), "<")
    if psnr > heights[-1]:
        return EquivalentPasses(float(passes[-1]), ">")
    return EquivalentPasses(float(np.exp(np.interp(psnr, heights, np.log(passes)))))


def snapshot_passes(passes: int) -> list[int]:
    """The points of a measured curve: 1, 3, 10, 30, ... below ``passes``, then ``passes``."""
    counts = [n * 10**e for e in range(7) for n in (1, 3)]
    return [*(n for n in counts if n < passes), passes]

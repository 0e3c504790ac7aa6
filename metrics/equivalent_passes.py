"""How many SPPM passes give an image of the same quality."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np


@dataclass(frozen=True)
class EquivalentPasses:
    """A number of passes, or a bound where the measured curve ends.

    ``bound`` is ``""`` for a number inside the curve, ``"<"`` when the image is
    worse than the curve's first point (worth fewer than ``passes``) and ``">"``
    when it is better than its last (worth more than ``passes``).
    """

    passes: float
    bound: Literal["", "<", ">"] = ""

    def __str__(self) -> str:
        """For a table: ``<3``, ``4.5``, ``137``, ``>1000``."""
        digits = 0 if self.passes >= 10 else 1
        return f"{self.bound}{self.passes:.{digits}f}".removesuffix(".0")


def equivalent_passes(psnr: float, curve: Mapping[int, float]) -> EquivalentPasses:
    """Find the number of SPPM passes that reach ``psnr`` (dB), from measured ones.

    ``curve`` maps a number of passes to the PSNR measured there; at least one
    point. Between two points log(passes) is linear in PSNR, because the error
    falls as a power of the number of passes. A point no better than one with
    fewer passes is noise and left out, which makes the curve strictly rising.
    Outside the curve nothing is extrapolated: the end point comes back as a bound.
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
    """Numbers of passes at which a curve is measured: 1, 3, 10, ... below ``passes``, and it."""
    counts = [n * 10**e for e in range(7) for n in (1, 3)]
    return [*(n for n in counts if n < passes), passes]

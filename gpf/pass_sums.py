"""What a set of passes has brought: sums that add up to the same bits in any grouping."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.exact_sums import ExactSum
from gpf.images import tone_map

_GREATEST_SQUARE = 2.0**51


class ViewTally:
    """Radiances that passes found at the pixels of one view, (N, 3), and how far they scatter.

    Odd and even passes are summed apart: two independent halves, whose difference tells how much
    noise is left after any processing that an image may get.

    Parameters
    ----------
    size: number of pixels N.
    """

    def __init__(self, size: int) -> None:
        self.halves = (ExactSum(size), ExactSum(size))
        # Of what is dim, the square is tiny: 2^-51 is that of 2e-8.
        self.squares = ExactSum(size, bits=51)

    def add(self, radiance: mi.Color3f, t: int) -> None:
        """Add what pass ``t`` found, W/(m² sr), (N, 3)."""
        dr.eval(radiance)  # each sum is a kernel of its own, and would trace it anew
        self.halves[t % 2].add(radiance)
        # A sun that is seen directly has more than fits: its error is then said to be less.
        self.squares.add(dr.minimum(radiance * radiance, _GREATEST_SQUARE))

    def add_tally(self, other: ViewTally) -> None:
        """Add what other passes found."""
        for mine, theirs in zip(self.halves, other.halves, strict=True):
            mine.add_tensors(theirs.tensors())
        self.squares.add_tensors(other.squares.tensors())

    def mean(self, passes: int) -> np.ndarray:
        """Mean radiance over all passes, (N, 3)."""
        return (self.halves[0].total() + self.halves[1].total()) / passes

    def standard_error(self, passes: int) -> np.ndarray:
        """σ of the mean, from the variance between passes, (N, 3); infinite after one pass.

        σ² = (⟨L²⟩ - ⟨L⟩²) / (n - 1)
        """
        if passes < 2:
            return np.full((self.squares.size, 3), np.inf)
        variance = self.squares.total() / passes - self.mean(passes) ** 2
        return np.sqrt(np.maximum(variance, 0) / (passes - 1))

    def ceiling(self, passes: int, exposure: float) -> float:
        """PSNR in dB that an independent image of as many passes is expected to have against this.

        The halves have half as many passes each, and differ by twice the squared error, on a
        tone-mapped scale:

            PSNR = -10 log₁₀ (⟨(T(odd) - T(even))²⟩ / 2)
        """
        if passes < 2:
            return -np.inf
        even, odd = passes // 2, passes - passes // 2
        images = [
            tone_map(half.total() / count, exposure)
            for half, count in zip(self.halves, (even, odd), strict=True)
        ]
        squared = float(np.mean((images[0] - images[1]) ** 2)) / 2
        return float(-10 * np.log10(squared)) if squared > 0 else np.inf


class PassSums:
    """Sums over a number of passes for some views and for some sets of fixed points.

    Parameters
    ----------
    views: number of pixels of each view whose image is accumulated.
    points: number of points in each set whose irradiance is.
    apart: whether direct light, which is part of it, is accumulated on its own as well.

    Attributes
    ----------
    passes: number of passes in the sums.
    """

    def __init__(
        self, views: Mapping[str, int], points: Mapping[str, int], apart: bool = False
    ) -> None:
        self.passes = 0
        self.views = {name: ViewTally(size) for name, size in views.items()}
        self.points = {name: ExactSum(size) for name, size in points.items()}
        self.direct = {name: ExactSum(size) for name, size in points.items() if apart}

    def tensors(self) -> dict[str, np.ndarray]:
        """Everything for a file, as integers."""
        return {
            f"{name}/{key}": array
            for name, part in self._parts().items()
            for key, array in part.tensors().items()
        }

    def add_tensors(self, tensors: Mapping[str, np.ndarray], passes: int) -> None:
        """Add the sums over ``passes`` other passes, as :meth:`tensors` gives them."""
        for name, part in self._parts().items():
            keys = ("whole", "steps", "broken")
            part.add_tensors({key: tensors[f"{name}/{key}"] for key in keys})
        self.passes += passes

    def _parts(self) -> dict[str, Any]:
        parts = {f"points/{name}": part for name, part in self.points.items()}
        parts |= {f"direct/{name}": part for name, part in self.direct.items()}
        for name, tally in self.views.items():
            parts |= {f"views/{name}/even": tally.halves[0], f"views/{name}/odd": tally.halves[1]}
            parts[f"views/{name}/squares"] = tally.squares
        return parts

"""What a set of passes has brought: sums that add up to the same bits in any grouping."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.images import tone_map

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

    def expected_psnr(self, passes: int, exposure: float) -> float:
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


# Terms beyond this have no sum: a thousand of them would not fit into 64 bits.
_LARGEST = 2.0**52


class ExactSum:
    """Sum of arrays of float32 colours, (N, 3), as whole numbers and multiples of a small step.

    Floating-point sums depend on their order in the last bits, so that parts of a long sum could
    not be made apart and then be put together. Integers have no such trouble. A term is cut to a
    multiple of the step; terms may be as large as 4e15. A lane with a term that is larger, or not
    finite, has no sum: NaN.

    Parameters
    ----------
    size: number of lanes N.
    bits: the step is 2^-bits: for 40, the default, 1e-12.
    """

    def __init__(self, size: int, bits: int = 40) -> None:
        self.size = size
        self._bits, self._step = bits, 2.0**-bits
        kind = dr.int64_array_t(mi.Color3f)
        self._whole = dr.zeros(kind, size)
        self._steps = dr.zeros(kind, size)
        self._broken = dr.zeros(mi.UInt32, size)

    def add(self, value: mi.Color3f) -> None:
        """Add one value per lane, (N, 3); evaluated at once."""
        kind = type(self._whole)
        finite = dr.all(dr.abs(value) < _LARGEST)
        value = dr.select(finite, value, 0)
        whole = dr.trunc(value)
        self._whole += kind(whole)
        self._steps += kind((value - whole) * (1 / self._step))
        self._broken |= dr.select(finite, mi.UInt32(0), 1)
        self._carry()

    def total(self) -> np.ndarray:
        """The sum, float64, (N, 3)."""
        whole, steps = (_rows(v).astype(np.float64) for v in (self._whole, self._steps))
        total = whole + steps * self._step
        total[np.asarray(self._broken.numpy()) > 0] = np.nan
        return total

    def tensors(self) -> dict[str, np.ndarray]:
        """The sum as integers for a file: (N, 3) twice, and which lanes are broken, (N,)."""
        return {
            "whole": _rows(self._whole),
            "steps": _rows(self._steps),
            "broken": np.asarray(self._broken.numpy()),
        }

    def add_tensors(self, tensors: Mapping[str, np.ndarray]) -> None:
        """Add another sum, as :meth:`tensors` gives it."""
        kind = type(self._whole)
        self._whole += kind(np.ascontiguousarray(tensors["whole"].T))
        self._steps += kind(np.ascontiguousarray(tensors["steps"].T))
        self._broken |= mi.UInt32(tensors["broken"])
        self._carry()

    def _carry(self) -> None:
        """Full steps become wholes: what is left, 0 to 2^bits - 1, has room for any more terms."""
        if self.size == 0:  # what is empty takes no operand of one lane
            return
        full = self._steps >> self._bits
        self._whole += full
        self._steps -= full << self._bits
        dr.eval(self._whole, self._steps, self._broken)


def _rows(value: Any) -> np.ndarray:
    return np.ascontiguousarray(value.numpy().T)

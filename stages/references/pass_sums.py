"""Sums over passes, with the same bits however the passes are grouped into ranges."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.images import tone_map
from gpf.core.structs import from_numpy, to_numpy

_GREATEST_SQUARE = 2.0**51


class ViewTally:
    """Sums over passes of the radiance of one view, (N, 3), and of its square.

    Odd and even passes are summed separately. The difference between these independent halves
    shows how much noise is left, even after any processing of the images.

    Parameters
    ----------
    size: number of pixels N.
    """

    def __init__(self, size: int) -> None:
        self.halves = (ExactSum(size), ExactSum(size))
        # Squares of small radiances are very small: 2^-51 is the square of 2e-8.
        self.squares = ExactSum(size, bits=51)

    def add(self, radiance: mi.Color3f, t: int) -> None:
        """Add the radiance of pass ``t``, W/(m² sr), (N, 3)."""
        dr.eval(radiance)  # otherwise the kernel of each sum would compute it again
        self.halves[t % 2].add(radiance)
        # The square of a directly visible sun may be too large; its error is then underestimated.
        self.squares.add(dr.minimum(radiance * radiance, _GREATEST_SQUARE))

    def add_tally(self, other: ViewTally) -> None:
        """Add the sums over other passes."""
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
        """Expected PSNR, in dB, of an independent image with as many passes against this image.

        T is the tone mapping. Each half has half of the passes, so its squared error is twice that
        of the whole. The squared difference between the halves is thus four times the squared error
        of one whole image; that between two whole images is twice this error:

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
    """Sums over passes, for views and for sets of fixed points.

    Parameters
    ----------
    views: number of pixels of each view whose image is accumulated, by name.
    points: number of points of each set whose irradiance is accumulated, by name.
    separate_direct: whether direct light, a part of the irradiance, is also summed on its own.

    Attributes
    ----------
    passes: number of passes in the sums.
    """

    def __init__(
        self, views: Mapping[str, int], points: Mapping[str, int], separate_direct: bool = False
    ) -> None:
        self.passes = 0
        self.views = {name: ViewTally(size) for name, size in views.items()}
        self.points = {name: ExactSum(size) for name, size in points.items()}
        self.direct = {name: ExactSum(size) for name, size in points.items() if separate_direct}

    def tensors(self) -> dict[str, np.ndarray]:
        """All sums as integers, for a file."""
        return {
            f"{name}/{key}": array
            for name, part in self._parts().items()
            for key, array in part.tensors().items()
        }

    def add_tensors(self, tensors: Mapping[str, np.ndarray], passes: int) -> None:
        """Add the sums over ``passes`` other passes, as returned by :meth:`tensors`."""
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


# Terms must be smaller than this: a thousand larger ones would not fit into 64 bits.
_LARGEST = 2.0**52


class ExactSum:
    """Sum of arrays of float32 colours, (N, 3), as whole numbers and multiples of a small step.

    The last bits of a floating-point sum depend on the order of its terms; integer sums do not, so
    parts of a long sum can be computed separately. A term is rounded towards zero to a multiple of
    the step and may be up to 4e15. If a lane gets a larger or non-finite term, its sum is NaN.

    Parameters
    ----------
    size: number of lanes N.
    bits: the step is 2^-bits; the default 40 gives 1e-12.
    """

    def __init__(self, size: int, bits: int = 40) -> None:
        self.size = size
        self._bits, self._step = bits, 2.0**-bits
        kind = dr.int64_array_t(mi.Color3f)
        self._whole = dr.zeros(kind, size)
        self._steps = dr.zeros(kind, size)
        self._broken = dr.zeros(mi.UInt32, size)

    def add(self, value: mi.Color3f) -> None:
        """Add one value per lane, (N, 3), and evaluate the sum."""
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
        whole, steps = (to_numpy(v).astype(np.float64) for v in (self._whole, self._steps))
        total = whole + steps * self._step
        total[np.asarray(self._broken.numpy()) > 0] = np.nan
        return total

    def tensors(self) -> dict[str, np.ndarray]:
        """The sum as integers for a file: ``whole`` and ``steps``, (N, 3), and ``broken``, (N,),
        which is 1 for lanes whose sum is NaN."""
        return {
            "whole": to_numpy(self._whole),
            "steps": to_numpy(self._steps),
            "broken": np.asarray(self._broken.numpy()),
        }

    def add_tensors(self, tensors: Mapping[str, np.ndarray]) -> None:
        """Add another sum, as returned by :meth:`tensors`."""
        kind = type(self._whole)
        self._whole += kind(np.ascontiguousarray(tensors["whole"].T))
        self._steps += kind(np.ascontiguousarray(tensors["steps"].T))
        self._broken |= from_numpy(mi.UInt32, tensors["broken"])
        self._carry()

    def _carry(self) -> None:
        """Move full units from ``steps`` to ``whole``; ``steps`` stays within 0 to 2^bits - 1."""
        if self.size == 0:  # Dr.Jit cannot combine an empty array with a single value
            return
        full = self._steps >> self._bits
        self._whole += full
        self._steps -= full << self._bits
        dr.eval(self._whole, self._steps, self._broken)

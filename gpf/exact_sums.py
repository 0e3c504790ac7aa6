"""Sums of floats that come out the same in whatever order and grouping they are added."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

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

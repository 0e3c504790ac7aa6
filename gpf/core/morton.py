"""An order of places in which those that follow each other lie close together.

Lanes of a packet run in step: what each of them finds around its point is found soonest where their
points have the same neighbours.
"""

from __future__ import annotations

import numpy as np

# Bits of each coordinate of a cell.
_BITS = 16


def order_in_space(positions: np.ndarray, cell: float) -> np.ndarray:
    """The order of positions (N, 3) along a Morton curve through cubes of edge length ``cell``.

    Positions of a cube stay in the order that they have. Beyond 65,536 cubes on an axis, all are as
    if in the last one.
    """
    if len(positions) == 0:
        return np.zeros(0, np.int64)
    offset = (positions - positions.min(axis=0)) / cell
    cube = np.minimum(offset, 2**_BITS - 1).astype(np.uint64)
    code = np.zeros(len(positions), np.uint64)
    for bit in range(_BITS):
        for axis in range(3):
            one = (cube[:, axis] >> np.uint64(bit)) & np.uint64(1)
            code |= one << np.uint64(3 * bit + axis)
    return np.argsort(code, kind="stable")

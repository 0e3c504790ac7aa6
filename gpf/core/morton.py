"""Sort positions along a Morton curve, so that consecutive positions lie close together.

The lanes of a packet run in step: neighbour queries are fastest if their points share neighbours.
"""

from __future__ import annotations

import numpy as np

# Bits of each coordinate of a cube.
_BITS = 16


def order_in_space(positions: np.ndarray, cell: float) -> np.ndarray:
    """Indices that sort positions (N, 3) along a Morton curve through cubes: (N,).

    Positions in the same cube keep their order. Each axis has at most 65,536 cubes; positions
    beyond the last cube count as in it.

    Parameters
    ----------
    cell: edge length of the cubes, in the unit of the positions.
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

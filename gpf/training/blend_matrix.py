"""A field's answers at fixed points, as a matrix: they are linear in the Gaussians' colours."""

from __future__ import annotations

import dataclasses
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from gpf.core.machine import count_cores
from gpf.core.structs import SurfacePoints
from gpf.field.field import GaussianPhotonField
from gpf.training.kernels import pack, pair_weights
from gpf.training.neighbours import list_neighbours

if TYPE_CHECKING:
    from scipy.sparse import csr_array

_TINY = 1e-20


def blend_matrix(field: GaussianPhotonField, points: SurfacePoints) -> csr_array:
    """The weights W of the Gaussians at the points, (P, N): with colours c, the field is W c."""
    from scipy.sparse import csr_array, diags_array  # slow to import

    points = dataclasses.replace(points, p=field.unfold(points.p))
    lists = list_neighbours(field, points)
    weights = np.array(pair_weights(points, lists, pack(field.gaussians)))
    starts, indices = np.array(lists.starts), np.array(lists.indices)
    pairs = int(starts[-1])
    shape = len(starts) - 1, len(np.array(field.gaussians.means.x))
    matrix = csr_array((weights[:pairs], indices[:pairs].astype(np.int32), starts), shape=shape)
    if field.settings.blend == "divided":
        sums = np.asarray(matrix.sum(axis=1))
        matrix = diags_array(1 / np.maximum(sums, _TINY)).astype(np.float32) @ matrix
    return matrix


class RowParts:
    """A sparse matrix in parts of consecutive rows, one for each core; the products have the same
    bits as those of the whole."""

    def __init__(self, matrix: csr_array) -> None:
        from scipy.sparse import csr_array  # slow to import

        rows, columns = matrix.shape
        ends = np.linspace(0, rows, count_cores() + 1).astype(int)
        starts, self._parts = matrix.indptr, []
        for first, last in pairwise(ends):
            pairs = slice(starts[first], starts[last])
            kept = matrix.data[pairs], matrix.indices[pairs], starts[first : last + 1] - pairs.start
            self._parts.append(csr_array(kept, shape=(last - first, columns)))
        self._pool = ThreadPoolExecutor(len(self._parts))  # scipy's products use one core each

    def __matmul__(self, values: np.ndarray) -> np.ndarray:
        """The product with values, (N, K)."""
        return np.concatenate(list(self._pool.map(lambda part: part @ values, self._parts)))

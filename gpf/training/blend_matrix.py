"""A field's answers at fixed points, as a matrix: they are linear in the Gaussians' colours."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

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

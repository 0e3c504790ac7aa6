"""Products of sparse matrices in parts."""

import numpy as np
import pytest

from gpf.training import blend_matrix
from gpf.training.blend_matrix import RowParts


@pytest.mark.parametrize("rows", [1, 7, 1000])
def test_parts_have_the_bits_of_the_whole(rows, monkeypatch):
    from scipy.sparse import random_array

    monkeypatch.setattr(blend_matrix, "count_cores", lambda: 3)
    matrix = random_array((rows, 50), density=0.2, format="csr", dtype=np.float32, rng=1)
    values = np.random.default_rng(2).random((50, 9), dtype=np.float32)
    np.testing.assert_array_equal(RowParts(matrix) @ values, matrix @ values)

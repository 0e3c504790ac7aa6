import numpy as np

from gpf.core.vectors import normalise


def test_each_vector_has_length_1_and_zero_stays_zero():
    vectors = np.array([[[3, 0, -4], [0, 0, 0]], [[0, 2, 0], [1, 2, 2]]])
    expected = [[[0.6, 0, -0.8], [0, 0, 0]], [[0, 1, 0], [1 / 3, 2 / 3, 2 / 3]]]
    np.testing.assert_allclose(normalise(vectors), expected, rtol=1e-15)
    np.testing.assert_array_equal(normalise([0, np.inf]), [0, np.nan])
    assert normalise(np.float32([3, 4])).dtype == np.float32

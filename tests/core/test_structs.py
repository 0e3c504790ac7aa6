"""Arrays that are joined, and turned into numpy's."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.core.structs import OrientedPoints, concatenate, from_numpy, to_numpy


def points(count: int) -> mi.Point3f:
    return from_numpy(mi.Point3f, np.arange(3.0 * count).reshape(count, 3))


def to_rows(count: int) -> np.ndarray:
    return to_numpy(points(count) + 1)


def join(count: int) -> np.ndarray:
    return to_numpy(concatenate([points(count), points(count + 3)]))


@pytest.mark.parametrize("work", [to_rows, join])
def test_other_numbers_of_values_need_no_other_kernels(work):
    def kernels(count):
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            work(count)
            return {kernel["hash"] for kernel in dr.kernel_history([dr.KernelType.JIT])}

    assert kernels(1000) == kernels(1010) != set()


def test_constant_columns_become_rows():
    rows = to_numpy(mi.Point3f(mi.Float([1, 2, 3]), 5, 6))
    np.testing.assert_array_equal(rows, [[1, 5, 6], [2, 5, 6], [3, 5, 6]])


@pytest.mark.parametrize("counts", [(4,), (4, 3), (4, 0, 1), (0, 0)])
def test_joined_arrays_hold_all_parts_in_order(counts):
    joined = to_numpy(concatenate([points(count) for count in counts]))
    expected = np.concatenate([to_numpy(points(count)) for count in counts])
    np.testing.assert_array_equal(joined, expected)


@pytest.mark.parametrize("counts", [(4,), (4, 3)])
def test_in_joined_structures_constants_are_repeated(counts):
    parts = [OrientedPoints(points(count), mi.Normal3f(0, 0, 1)) for count in counts]
    joined = concatenate(parts)
    assert dr.width(joined.n.z) == sum(counts)
    np.testing.assert_array_equal(to_numpy(joined.n), sum(counts) * [[0, 0, 1]])


def test_one_part_is_joined_to_an_array_of_its_own():
    part = mi.Float([1, 2])
    joined = concatenate([part])
    joined += 1
    assert part.numpy().tolist() == [1, 2]

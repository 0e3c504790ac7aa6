"""Dr.Jit's kernels read whole packets of values: behind the last one there has to be room."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.core.structs import from_numpy, to_numpy

PROJECT = Path(__file__).parents[2]
FLAT = ("Float", "Float64", "UInt32", "Int32", "UInt64", "Bool", "TensorXf")
VECTOR = re.compile("(Point|Vector|Normal|Color|Quaternion)[234][fiu]")

# An array at the end of a page, before one that must not be read.
AT_THE_EDGE = """
import ctypes, sys
import mitsuba as mi
import numpy as np
mi.set_variant("llvm_ad_rgb")
from gpf.core.structs import from_numpy, to_numpy
libc, page = ctypes.CDLL(None), 4096
libc.mmap.restype = ctypes.c_void_p
libc.mmap.argtypes = [ctypes.c_void_p, ctypes.c_size_t] + 3 * [ctypes.c_int] + [ctypes.c_long]
libc.mprotect.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int]
start = libc.mmap(None, 2 * page, 3, 0x22, -1, 0)
libc.mprotect(start + page, page, 0)
values = np.frombuffer((ctypes.c_char * page).from_address(start), np.float32)[-6:]
values[:] = 1, 2, 3, 4, 5, 6
kind, way = getattr(mi, sys.argv[1]), sys.argv[2]
if kind is mi.Point2f:
    values = values.reshape(2, 3).T
made = from_numpy(kind, values) if way == "copied" else kind(values.T)
print((made + 1).numpy().ravel().tolist())
"""


@pytest.mark.parametrize("kind", FLAT)
def test_values_and_shapes_are_kept(kind):
    values = np.array([[0, 1, 1], [1, 0, 1]])
    kind = getattr(mi, kind)
    made = from_numpy(kind, values if kind is mi.TensorXf else values[0])
    assert type(made) is kind and dr.width(made) > 0
    np.testing.assert_array_equal(made.numpy(), values if kind is mi.TensorXf else values[0])


@pytest.mark.parametrize("kind", ["Point2u", "Normal3f", "Quaternion4f"])
def test_vectors_have_a_row_per_lane(kind):
    kind = getattr(mi, kind)
    values = np.arange(5.0 * dr.size_v(kind)).reshape(5, -1)
    made = from_numpy(kind, values)
    assert type(made) is kind
    np.testing.assert_array_equal(to_numpy(made), values)


def test_other_layouts_and_nothing_at_all():
    values = np.arange(12.0).reshape(3, 4)
    np.testing.assert_array_equal(from_numpy(mi.Float, values[:, 1]).numpy(), [1, 5, 9])
    assert dr.width(from_numpy(mi.UInt32, np.zeros(0))) == 0
    assert dr.width(from_numpy(mi.Point3f, np.zeros((0, 3)))) == 0


@pytest.mark.skipif(sys.platform != "linux", reason="calls mmap with the constants of Linux")
@pytest.mark.parametrize("kind", ["Float", "Point2f"])
def test_nothing_is_read_behind_the_values(kind):
    def run(way):
        command = [sys.executable, "-c", AT_THE_EDGE, kind, way]
        return subprocess.run(command, capture_output=True, text=True, cwd=PROJECT, check=False)

    assert run("copied").stdout == "[2.0, 3.0, 4.0, 5.0, 6.0, 7.0]\n"
    if kind == "Float":  # When Dr.Jit no longer does this, no copy is needed.
        assert run("as it is").returncode < 0


def test_no_module_gives_dr_jit_the_memory_of_numpy():
    """Calls such as ``mi.Float(x.astype(...))``, found by what is inside of them."""
    signs = ("np.", ".astype(", ".numpy(", ".ravel(", "tensors[", ".T", "rng.random(")
    found = []
    for top in ("gpf", "stages", "benchmarks", "tests"):
        for path in (PROJECT / top).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)):
                    continue
                owner = node.func.value
                if not (isinstance(owner, ast.Name) and owner.id == "mi"):
                    continue
                text = " ".join(ast.unparse(argument) for argument in node.args)
                made = node.func.attr in FLAT or VECTOR.fullmatch(node.func.attr)
                inside = text.replace("np.pi", "")
                if made and any(sign in inside for sign in signs) and "from_numpy" not in text:
                    found.append(f"{path.name}:{node.lineno}: {ast.unparse(node)}")
    assert found == []

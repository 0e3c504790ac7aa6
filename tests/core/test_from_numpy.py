"""Dr.Jit's kernels read whole packets of values: behind the last one there has to be room."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.core.structs import from_numpy

PROJECT = Path(__file__).parents[2]
FLAT = ("Float", "Float64", "UInt32", "Int32", "UInt64", "Bool", "TensorXf")

# An array at the end of a page, before one that must not be read.
AT_THE_EDGE = """
import ctypes, sys
import mitsuba as mi
import numpy as np
mi.set_variant("llvm_ad_rgb")
from gpf.core.structs import from_numpy
libc, page = ctypes.CDLL(None), 4096
libc.mmap.restype = ctypes.c_void_p
libc.mmap.argtypes = [ctypes.c_void_p, ctypes.c_size_t] + 3 * [ctypes.c_int] + [ctypes.c_long]
libc.mprotect.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int]
start = libc.mmap(None, 2 * page, 3, 0x22, -1, 0)
libc.mprotect(start + page, page, 0)
values = np.frombuffer((ctypes.c_char * page).from_address(start), np.float32)[-3:]
values[:] = 1, 2, 3
made = from_numpy(mi.Float, values) if sys.argv[1] == "copied" else mi.Float(values)
print((made + 1).numpy().tolist())
"""


@pytest.mark.parametrize("kind", FLAT)
def test_values_and_shapes_are_kept(kind):
    values = np.array([[0, 1, 1], [1, 0, 1]])
    kind = getattr(mi, kind)
    made = from_numpy(kind, values if kind is mi.TensorXf else values[0])
    assert type(made) is kind and dr.width(made) > 0
    np.testing.assert_array_equal(made.numpy(), values if kind is mi.TensorXf else values[0])


def test_other_layouts_and_nothing_at_all():
    values = np.arange(12.0).reshape(3, 4)
    np.testing.assert_array_equal(from_numpy(mi.Float, values[:, 1]).numpy(), [1, 5, 9])
    assert dr.width(from_numpy(mi.UInt32, np.zeros(0))) == 0


@pytest.mark.skipif(sys.platform != "linux", reason="the numbers of mmap are those of Linux")
def test_nothing_is_read_behind_the_values():
    def run(way):
        command = [sys.executable, "-c", AT_THE_EDGE, way]
        return subprocess.run(command, capture_output=True, text=True, cwd=PROJECT, check=False)

    assert run("copied").stdout == "[2.0, 3.0, 4.0]\n"
    # When Dr.Jit no longer does this, `from_numpy` can go.
    assert run("as it is").returncode < 0


def test_no_module_gives_dr_jit_the_memory_of_numpy():
    """Calls such as ``mi.Float(x.astype(...))``, found by what is inside of them."""
    found = []
    for top in ("gpf", "stages"):
        for path in (PROJECT / top).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)):
                    continue
                owner = node.func.value
                if not (isinstance(owner, ast.Name) and owner.id == "mi"):
                    continue
                text = " ".join(ast.unparse(argument) for argument in node.args)
                signs = ("np.", ".astype(", ".numpy(", ".ravel(", "tensors[")
                if node.func.attr in FLAT and any(sign in text for sign in signs):
                    found.append(f"{path.name}:{node.lineno}: {ast.unparse(node)}")
    assert found == []

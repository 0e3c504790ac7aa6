"""Meshes and textures: good ones, and such as have no faces, no size or no meaning."""

from __future__ import annotations

import struct
import zlib
from typing import Any

import numpy as np
from hypothesis import strategies as st

from tests.fuzz import odd

OBJ = """\
v -1 0 0
v 1 0 0
v 0 1 -0.5
v 0 0 1
vt 0 0
vt 1 0
vn 0 0 1
f 1 2 3
f 2 3 4
f 1/1 2/2 3/1
f 1//1 2//1 4//1
"""
PLY = """\
ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 2
property list uchar int vertex_indices
end_header
"""
PLY_ROWS = "-1 0 0\n1 0 0\n0 1 -0.5\n0 0 1\n3 0 1 2\n3 3 1 0\n"
PLY_BYTES = np.array([[-1, 0, 0], [1, 0, 0], [0, 1, -0.5], [0, 0, 1]], "<f4").tobytes()
PLY_BYTES += struct.pack("<B3iB3i", 3, 0, 1, 2, 3, 3, 1, 0)
SIZES = ((0, 0), (0, 3), (2**31 - 1, 2**31 - 1), (60000, 60000), (5, 5))


def list_of(value: Any) -> list[Any]:
    """A list, or one of only this."""
    return value if isinstance(value, list) else [value]


def changed_lines(draw: st.DrawFn, text: str) -> bytes:
    """A text of words and numbers of which a few lines or words are others."""
    words = odd.changed_tree(draw, [line.split() for line in text.splitlines()])
    lines = map(list_of, list_of(words))
    return "".join(" ".join(map(str, line)) + "\n" for line in lines).encode()


def png(draw: st.DrawFn, faulty: bool) -> bytes:
    """A PNG file; a faulty one has no size, or one that its pixels do not have."""
    width, height = draw(st.sampled_from([(1, 1), (2, 3), (4, 2)]))
    told = draw(st.sampled_from(SIZES)) if faulty else (width, height)
    chunks = {
        b"IHDR": struct.pack(">2I5B", *told, 8, 2, 0, 0, 0),
        b"IDAT": zlib.compress((b"\0" + b"\x40\xc0\x80" * width) * height),
        b"IEND": b"",
    }
    data = b"\x89PNG\r\n\x1a\n"
    for kind, content in chunks.items():
        check = struct.pack(">I", zlib.crc32(kind + content))
        data += struct.pack(">I", len(content)) + kind + content + check
    return data


@st.composite
def files(draw: st.DrawFn, form: str) -> bytes:
    """A file of this format, "ply", "obj" or "png"; some have faults."""
    faulty = odd.rarely(draw, 6)
    if form == "png":
        data = png(draw, faulty)
    else:
        binary = form == "ply" and draw(st.booleans())
        head = PLY.replace("ascii", "binary_little_endian") if binary else PLY + PLY_ROWS
        text = OBJ if form == "obj" else head
        data = changed_lines(draw, text) if faulty else text.encode()
        data += PLY_BYTES if binary else b""
    return odd.changed_bytes(draw, data) if odd.rarely(draw, 12) else data

"""Find meshes whose triangles refer to vertices that do not exist, and meshes without triangles:
Mitsuba would crash or give an unclear message.

Each check skips files of other kinds. Mitsuba itself reports all other errors on reading a file.
"""

from __future__ import annotations

import mmap
import re
import struct
import warnings
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from gpf.core.errors import UserError
from gpf.core.machine import require_memory

_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"},
    **{"long": "i8", "ulong": "u8", "half": "f2", "float16": "f2"},
    **{"float": "f4", "double": "f8", "float32": "f4", "float64": "f8"},
}

_SERIALIZED = (b"\x1c\x04\x03\x00", b"\x1c\x04\x04\x00")
"""The first bytes of Mitsuba's own format, versions 3 and 4."""

Elements = list[tuple[str, int, list[list[str]]]]
"""Elements of a PLY file: name, count, and the words of each property."""

Corners = np.ndarray | None
"""The vertices of all triangles; None if the file is shorter than its header says."""


class _NoTriangles(Exception):
    """A mesh has faces that do not have three corners."""


def check_ply(file: Path, where: str) -> None:
    """Raise a :class:`UserError` if a PLY file has a triangle with a vertex that does not exist,
    has no triangles, or is shorter than its header says.

    Parameters
    ----------
    where: place in the scene file that names the mesh, for the message.
    """
    with file.open("rb") as stream:
        if stream.read(256).lstrip()[:3] != b"ply":
            return
    data = _mapped(file)
    end = re.search(rb"(?m)^[ \t]*end_header[ \t]*\r?\n", data)
    try:
        if end is None:
            return
        form, elements = _read_header(data[: end.start()].decode("utf-8", "replace"))
        # Mitsuba uses the last one if there are several.
        vertices = min((count for name, count, _ in elements if name == "vertex"), default=0)
        if form == "ascii":
            corners = _text_corners(data[end.end() :], elements)
        else:
            order = ">" if form == "binary_big_endian" else "<"
            corners = _binary_corners(data, end.end(), elements, order)
    except _NoTriangles:
        what = "has faces that are not triangles"
        raise UserError(where, f"refers to {file}, which {what}", "Export triangles.") from None
    except (ValueError, KeyError, IndexError, OverflowError, StopIteration):
        return
    if corners is not None and not len(corners):
        raise _no_triangles(file, where)
    _require_vertices(file, where, corners, vertices)


def check_obj(file: Path, where: str) -> None:
    """Raise a :class:`UserError` if an OBJ file has no faces."""
    if file.suffix.lower() != ".obj":
        return
    # The first face is found quickly, however large the file is.
    if not file.stat().st_size or not re.search(rb"(?m)^[ \t]*f[ \t]", _mapped(file)):
        raise _no_triangles(file, where)


def check_serialized(file: Path, where: str) -> None:
    """Raise a :class:`UserError` if a triangle of a file in Mitsuba's own format refers to a vertex
    that does not exist.

    The file consists of compressed meshes, with a list of their offsets at the end.
    """
    with file.open("rb") as stream:
        if stream.read(4) not in _SERIALIZED:
            return
    data = memoryview(_mapped(file))
    wide = data[2] == 4  # 8-byte offsets, and meshes with names
    begin = len(data) - 4 - int.from_bytes(data[-4:], "little") * (8 if wide else 4)
    listed = data[begin:-4] if begin > 0 else b""
    # The first mesh is read even without the list.
    for place in sorted({0, *np.frombuffer(listed, "<u8" if wide else "<u4").tolist()}):
        try:
            vertices, corners = _serialized_corners(data, place, wide, where)
        except (ValueError, IndexError, struct.error, zlib.error):
            continue
        _require_vertices(file, where, corners, vertices)


def _mapped(file: Path) -> mmap.mmap:
    """The bytes of a non-empty file, read on access."""
    with file.open("rb") as stream:
        return mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)


def _no_triangles(file: Path, where: str) -> UserError:
    return UserError(where, f"refers to {file}, which has no triangles", "Remove the shape.")


def _require_vertices(file: Path, where: str, corners: Corners, vertices: int) -> None:
    if corners is None:
        what = "is shorter than its header says"
    elif len(corners) and not (corners.min() >= 0 and corners.max() < vertices):
        wrong = int(corners.max() if corners.max() >= vertices else corners.min())
        what = f"has a triangle with vertex {wrong} of {vertices}"
    else:
        return
    raise UserError(where, f"refers to {file}, which {what}", "Export the mesh again.")


def _read_header(text: str) -> tuple[str, Elements]:
    """The format and the elements, in the order of the file."""
    form, elements = "", Elements()
    for line in text.splitlines():
        words = line.split()
        if words[:1] == ["format"]:
            form = words[1]
        elif words[:1] == ["element"]:
            elements.append((words[1], int(words[2]), []))
        elif words[:1] == ["property"]:
            elements[-1][2].append(words[1:])
    return form, elements


def _text_corners(body: bytes, elements: Elements) -> Corners:
    """The vertices of all triangles of a text file."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)  # a word that is not a number
        try:
            numbers = np.fromstring(body, sep=" ")
        except DeprecationWarning as error:
            raise ValueError from error
    at, found = 0, [np.zeros((0, 3), np.int64)]
    for name, count, properties in elements:
        lists = [k for k, property in enumerate(properties) if property[0] == "list"]
        width = len(properties) + 3 * len(lists)  # a list of three takes four numbers
        rows = numbers[at : at + count * width]
        if name == "face" and count:
            # Rows of other faces have other lengths, but the first wrong count is found.
            whole = rows[: len(rows) // width * width].reshape(-1, width)
            if (whole[:, lists[0]] != 3).any():
                raise _NoTriangles
            found.append(whole[:, lists[0] + 1 : lists[0] + 4].astype(np.int64))
        if len(rows) < count * width:
            return None
        at += count * width
    return np.concatenate(found)


def _binary_corners(data: mmap.mmap, at: int, elements: Elements, order: str) -> Corners:
    """The vertices of all triangles of a binary file, whose elements begin at ``at``."""
    found = [np.zeros((0, 3), np.int64)]
    for name, count, properties in elements:
        fields: list[Any] = []
        for k, words in enumerate(properties):
            if words[0] == "list":
                fields.append((f"count_{k}", order + _TYPES[words[1]]))
                fields.append((f"list_{k}", order + _TYPES[words[2]], (3,)))
            else:
                fields.append((f"value_{k}", order + _TYPES[words[0]]))
        kind = np.dtype(fields)
        there = min(count, (len(data) - at) // kind.itemsize)
        if name == "face" and count:
            rows = np.frombuffer(data, kind, there, at)
            first = next(field for field in kind.names or () if field.startswith("list"))
            if (rows[first.replace("list", "count")] != 3).any():
                raise _NoTriangles
            found.append(rows[first].astype(np.int64))
        if there < count:
            return None
        at += count * kind.itemsize
    return np.concatenate(found)


def _serialized_corners(
    data: memoryview, place: int, wide: bool, where: str
) -> tuple[int, Corners]:
    """The number of vertices of a mesh in Mitsuba's format, and the vertices of its triangles."""
    if data[place : place + 4] not in _SERIALIZED:
        raise ValueError
    stream = zlib.decompressobj()
    head = stream.decompress(data[place + 4 :], 4096)
    (flags,) = struct.unpack_from("<I", head)
    at = head.index(b"\0", 4) + 1 if wide else 4
    vertices, faces = struct.unpack_from("<QQ", head, at)
    # Positions, then normals, texture coordinates and colours if there are any.
    values = 3 + 3 * bool(flags & 1) + 2 * bool(flags & 2) + 3 * bool(flags & 8)
    at += 16 + vertices * values * (8 if flags & 0x2000 else 4)
    size = at + 12 * faces
    require_memory(where, f"a mesh of {vertices} vertices and {faces} triangles", 2 * size)
    body = head + stream.decompress(stream.unconsumed_tail, max(size - len(head), 1))
    if size > len(body):
        return vertices, None
    return vertices, np.frombuffer(body, "<u4", 3 * faces, at).astype(np.int64)

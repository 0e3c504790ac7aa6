"""Meshes and textures: good ones, and such as have no faces, no size or no meaning."""

from __future__ import annotations

import random
import struct
import zlib

from tests.fuzz import odd

OBJ = "v -1 0 0\nv 1 0 0\nv 0 1 -0.5\nv 0 0 1\nvt 0 0\nvt 1 0\nvn 0 0 1\n"


def _coordinate(rng: random.Random, wild: float) -> str:
    return str(odd.number(rng)) if rng.random() < wild else f"{rng.uniform(-1, 1):.3g}"


def ply(rng: random.Random, wild: float) -> bytes:
    """A PLY file of a few triangles, in text or binary."""
    vertices, faces = rng.choice([0, 1, 3, 4, 4, 4]), rng.choice([0, 1, 2, 2, 2])
    points = [[_coordinate(rng, wild) for _ in range(3)] for _ in range(vertices)]
    most = rng.choice([vertices - 1] * 5 + [vertices, 2**31 - 1, -1])
    corners = [[rng.randint(min(0, most), max(0, most)) for _ in range(3)] for _ in range(faces)]
    told = [vertices, faces]
    if rng.random() < wild:
        told[rng.randrange(2)] = rng.choice([0, 1, 7, 10**6, 2**31, 2**40, -1])
    binary = rng.random() < 0.4
    head = (
        f"ply\nformat {'binary_little_endian' if binary else 'ascii'} 1.0\n"
        f"element vertex {told[0]}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {told[1]}\nproperty list uchar int vertex_indices\nend_header\n"
    ).encode()
    if binary:
        body = b"".join(struct.pack("<3f", *map(_single, point)) for point in points)
        body += b"".join(struct.pack("<B3i", 3, *c) for c in corners)
    else:
        rows = [" ".join(point) for point in points]
        rows += [f"3 {' '.join(map(str, c))}" for c in corners]
        body = ("\n".join(rows) + "\n").encode()
    return odd.change_bytes(rng, head + body) if rng.random() < wild else head + body


def _single(text: str) -> float:
    value = float(text)
    return value if abs(value) < 3e38 or value != value else float("inf")


def obj(rng: random.Random, wild: float) -> bytes:
    """A Wavefront OBJ file of a few triangles."""
    faces = ["f 1 2 3", "f 1/1 2/2 3/1", "f 2 3 4", "f 1//1 2//1 4//1"]
    bad = ["f 1 2", "f 9 9 9", "f 0 1 2", "f -1 -2 -3", "f a b c", "v nan nan nan", "vt inf 0"]
    bad += ["v 1e39 0 0", "f 1/9/9 2/9/9 3/9/9", "mtllib ../../x", "f 99999999999 1 2"]
    lines = rng.sample(faces, rng.randint(0, 3))
    lines += rng.sample(bad, 1 if rng.random() < wild else 0)
    data = (OBJ + "\n".join(lines) + "\n").encode()
    return odd.change_bytes(rng, data) if rng.random() < wild else data


def _chunk(kind: bytes, data: bytes) -> bytes:
    whole = kind + data
    return struct.pack(">I", len(data)) + whole + struct.pack(">I", zlib.crc32(whole))


def png(rng: random.Random, wild: float) -> bytes:
    """A PNG file, perhaps of no size, or of one that it does not have."""
    width, height = rng.choice([(1, 1), (2, 3), (4, 2)])
    told = (width, height)
    if rng.random() < wild:
        told = rng.choice([(0, 0), (0, 3), (2**31 - 1, 2**31 - 1), (60000, 60000), (5, 5)])
    rows = b"".join(b"\0" + rng.randbytes(3 * width) for _ in range(height))
    data = b"\x89PNG\r\n\x1a\n" + _chunk(b"IHDR", struct.pack(">2I5B", *told, 8, 2, 0, 0, 0))
    data += _chunk(b"IDAT", zlib.compress(rows)) + _chunk(b"IEND", b"")
    return odd.change_bytes(rng, data) if rng.random() < wild else data

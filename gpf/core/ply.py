"""Writing PLY files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from gpf.core.files import write_atomically


def write_ply(
    path: Path, columns: Mapping[str, np.ndarray], faces: np.ndarray | None = None
) -> None:
    """Write a binary PLY file, atomically.

    Parameters
    ----------
    columns: properties of vertices: names, such as ``x y z``, with their values, (V, K); what is
        not uint8 is written as float32.
    faces: indices of vertices, (M, 3).
    """
    named = [(n, v[:, k]) for names, v in columns.items() for k, n in enumerate(names.split())]
    kinds = [(name, "u1" if values.dtype == np.uint8 else "<f4") for name, values in named]
    vertices = np.empty(len(named[0][1]), dtype=kinds)
    for name, values in named:
        vertices[name] = values
    words = {"u1": "uchar", "<f4": "float"}
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}"]
    header += [f"property {words[kind]} {name}" for name, kind in kinds]
    data = vertices.tobytes()
    if faces is not None:
        triangles = np.empty(len(faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
        triangles["count"], triangles["corners"] = 3, faces
        header += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
        data += triangles.tobytes()
    text = "\n".join([*header, "end_header\n"]).encode("ascii")
    write_atomically(path, lambda p: p.write_bytes(text + data))

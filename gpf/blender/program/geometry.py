"""Meshes as Blender renders them, as PLY files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

Columns = dict[str, np.ndarray]


@dataclass(frozen=True)
class Part:
    """The triangles of a mesh with one material.

    Attributes
    ----------
    columns: one array, (V,), for each property of a vertex, by its name in PLY files.
    faces: (F, 3).
    """

    slot: int
    columns: Columns
    faces: np.ndarray


def read_parts(mesh: Any, uv_layer: str | None, colours: str | None) -> list[Part]:
    """The parts of an evaluated mesh, in its own coordinates.

    Parameters
    ----------
    uv_layer: name of the UVs to write; by default, those that Blender renders.
    colours: name of the colour attribute to write, if any.
    """
    mesh.calc_loop_triangles()
    triangles = mesh.loop_triangles
    if not len(triangles):
        return []
    corners = _column(triangles, "loops", 3, np.int32)
    slots = _column(triangles, "material_index", 1, np.int32).ravel()
    vertex_of = _column(mesh.loops, "vertex_index", 1, np.int32).ravel()
    places = _column(mesh.vertices, "co", 3)
    data = [places[vertex_of], _column(mesh.corner_normals, "vector", 3)]
    names = ["x", "y", "z", "nx", "ny", "nz"]
    layer = mesh.uv_layers.get(uv_layer) if uv_layer else _rendered_uv(mesh)
    if layer is not None and len(layer.uv):
        uv = _column(layer.uv, "vector", 2)
        uv[:, 1] = 1 - uv[:, 1]  # Mitsuba's images begin at the top
        data.append(uv)
        names += ["u", "v"]
    if colours and (found := mesh.color_attributes.get(colours)) is not None:
        values = _column(found.data, "color", 4)[:, :3]
        if found.domain == "POINT":
            values = values[vertex_of]
        if found.domain in ("POINT", "CORNER"):
            data.append(values)
            names += ["r", "g", "b"]
    rows = np.ascontiguousarray(np.concatenate(data, axis=1, dtype=np.float32))
    parts = []
    for slot in np.unique(slots):
        own, faces = _shared(rows, corners[slots == slot])
        columns = {name: own[:, k] for k, name in enumerate(names)}
        parts.append(Part(int(slot), columns, faces))
    return parts


def _column(items: Any, name: str, width: int, kind: Any = np.float32) -> np.ndarray:
    values = np.empty(len(items) * width, kind)
    items.foreach_get(name, values)
    return values.reshape(-1, width)


def _rendered_uv(mesh: Any) -> Any:
    return next((layer for layer in mesh.uv_layers if layer.active_render), None)


def _shared(rows: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices without duplicates, and the faces that refer to them, from one row per corner."""
    used = corners.ravel()
    # Sorting numbers is ten times as fast as sorting rows.
    bits = rows[used].view(np.uint32).astype(np.uint64)
    key = np.zeros(len(used), np.uint64)
    for column in bits.T:
        key = (key ^ column) * np.uint64(0x9E3779B97F4A7C15)
        key ^= key >> np.uint64(29)
    _, first, index = np.unique(key, return_index=True, return_inverse=True)
    return rows[used[first]], index.reshape(-1, 3).astype(np.int32)


def transformed(part: Part, matrix: np.ndarray) -> Part:
    """A part in other coordinates; ``matrix`` is 4×4."""
    columns = dict(part.columns)
    place = np.stack([columns[c] for c in "xyz"], axis=1) @ matrix[:3, :3].T + matrix[:3, 3]
    linear = matrix[:3, :3].astype(np.float64)
    cofactors = np.cross(linear[[1, 2, 0]], linear[[2, 0, 1]])  # det(M) M⁻ᵀ, also if M is singular
    mirrored = np.linalg.det(linear) < 0
    normal = np.stack([columns[c] for c in ("nx", "ny", "nz")], axis=1) @ cofactors.T
    normal *= -1 if mirrored else 1
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    columns |= {c: place[:, k] for k, c in enumerate("xyz")}
    columns |= {f"n{c}": normal[:, k] for k, c in enumerate("xyz")}
    faces = part.faces[:, ::-1] if mirrored else part.faces
    return Part(part.slot, columns, faces)


def is_open(part: Part) -> bool:
    """Whether a part has an edge of a single face; vertices in one place are the same."""
    place = np.ascontiguousarray(np.stack([part.columns[c] for c in "xyz"], axis=1))
    keys = place.view(np.dtype((np.void, place.dtype.itemsize * 3))).ravel()
    _, same = np.unique(keys, return_inverse=True)
    faces = same.reshape(-1)[part.faces]
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    _, uses = np.unique(edges, axis=0, return_counts=True)
    return bool((uses == 1).any())


def other_side(part: Part, distance: float) -> Part:
    """The part seen from behind, a little further back."""
    columns = dict(part.columns)
    for c in "xyz":
        columns[c] = columns[c] - np.float32(distance) * columns[f"n{c}"]
        columns[f"n{c}"] = -columns[f"n{c}"]
    return Part(part.slot, columns, part.faces[:, ::-1])


def is_finite(part: Part) -> bool:
    """Whether all coordinates are numbers."""
    return all(np.isfinite(column).all() for column in part.columns.values())


def area(part: Part) -> float:
    """Total area of the triangles."""
    place = np.stack([part.columns[c] for c in "xyz"], axis=1).astype(np.float64)
    a, b, c = (place[part.faces[:, k]] for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def write_ply(path: Path, part: Part) -> None:
    """Write a binary PLY file."""
    vertices = np.empty(len(next(iter(part.columns.values()))), [(n, "<f4") for n in part.columns])
    for name, column in part.columns.items():
        vertices[name] = column
    faces = np.empty(len(part.faces), [("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, part.faces
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}"]
    header += [f"property float {name}" for name in part.columns]
    header += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    with path.open("wb") as out:
        out.write("\n".join([*header, ""]).encode())
        out.write(vertices.tobytes())
        out.write(faces.tobytes())

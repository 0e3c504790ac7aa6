"""Meshes as Blender renders them, as PLY files."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

Columns = dict[str, np.ndarray]

NORMAL = ("nx", "ny", "nz")


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


@dataclass(frozen=True)
class Corners:
    """The corners of a mesh's faces, and its triangles.

    Attributes
    ----------
    names: what is known of each corner, by its names in PLY files.
    rows: its values, (L, len(names)).
    triangles: three corners each, (F, 3).
    slots: the material of each, (F,).
    same: corners with the same values here become one vertex, (L, K).
    """

    names: list[str]
    rows: np.ndarray
    triangles: np.ndarray
    slots: np.ndarray
    same: np.ndarray

    def digest(self, *more: Any) -> bytes:
        """A digest of everything, and of ``more``."""
        found = hashlib.blake2b(repr([self.names, *more]).encode(), digest_size=16)
        for values in (self.rows, self.triangles, self.slots, self.same):
            found.update(values.tobytes())
        return found.digest()

    def parts(self) -> list[Part]:
        """The triangles of each material."""
        parts = []
        for slot in np.unique(self.slots):
            own, faces = _shared(self.rows, self.same, self.triangles[self.slots == slot])
            columns = {name: own[:, k] for k, name in enumerate(self.names)}
            parts.append(Part(int(slot), columns, faces))
        return parts


Triangles = dict[bytes, np.ndarray]
"""The corners of triangles, (F, 3), by a digest of a mesh's faces."""


def read_corners(
    mesh: Any, unwrapped: np.ndarray | None, colours: str | None, bent: Triangles | None
) -> Corners:
    """The corners of an evaluated mesh, in its own coordinates.

    Parameters
    ----------
    unwrapped: the UVs to write, (L, 2); by default, those that Blender renders.
    colours: name of the colour attribute to write, if any.
    bent: None, or the triangles of this mesh in other frames, where it may have another shape. With
        the same faces it has the same triangles: Blender would cut some faces along the other
        diagonal, and corners with the same normals would be one vertex for now.
    """
    mesh.calc_loop_triangles()
    triangles = mesh.loop_triangles
    vertices = column(mesh.loops, "vertex_index", 1, np.int32).ravel()
    place = column(mesh.vertices, "co", 3)[vertices]
    data, names = [place, column(mesh.corner_normals, "vector", 3)], ["x", "y", "z", *NORMAL]
    layer = _rendered_uv(mesh)
    if unwrapped is not None or (layer is not None and len(layer.uv)):
        uv = column(layer.uv, "vector", 2) if unwrapped is None else unwrapped.copy()
        uv[:, 1] = 1 - uv[:, 1]  # Mitsuba's images begin at the top
        data.append(uv)
        names += ["u", "v"]
    if colours and (found := mesh.color_attributes.get(colours)) is not None:
        values = column(found.data, "color", 4)[:, :3]
        if found.domain == "POINT":
            values = values[vertices]
        if found.domain in ("POINT", "CORNER"):
            data.append(values)
            names += ["r", "g", "b"]
    rows = np.ascontiguousarray(np.concatenate(data, axis=1, dtype=np.float32))
    same = rows
    corners = column(triangles, "loops", 3, np.int32)
    if bent is not None:
        corners = bent.setdefault(digest_of_faces(mesh), corners)
        smooth = mesh.normals_domain == "POINT" and "sharp_edge" not in mesh.attributes
        apart = vertices if smooth else np.arange(len(vertices))
        same = np.column_stack([apart.astype(np.int32).view(np.float32), rows[:, 6:]])
    slots = column(triangles, "material_index", 1, np.int32).ravel()
    return Corners(names, rows, corners, slots, same)


def digest_of_faces(mesh: Any) -> bytes:
    """A digest of a mesh's faces."""
    corners = column(mesh.loops, "vertex_index", 1, np.int32)
    found = hashlib.blake2b(corners.tobytes(), digest_size=16)
    found.update(column(mesh.polygons, "loop_start", 1, np.int32).tobytes())
    return found.digest()


def column(items: Any, name: str, width: int, kind: Any = np.float32) -> np.ndarray:
    """A property of all items of a mesh, (N, width)."""
    values = np.empty(len(items) * width, kind)
    items.foreach_get(name, values)
    return values.reshape(-1, width)


def _rendered_uv(mesh: Any) -> Any:
    return next((layer for layer in mesh.uv_layers if layer.active_render), None)


def _shared(
    rows: np.ndarray, same: np.ndarray, corners: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Vertices without duplicates, and the faces that refer to them, from one row per corner."""
    used = corners.ravel()
    # Sorting numbers is ten times as fast as sorting rows.
    bits = same[used].view(np.uint32).astype(np.uint64)
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
    normal = np.stack([columns[c] for c in NORMAL], axis=1) @ cofactors.T
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

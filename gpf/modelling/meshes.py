"""Triangle meshes from boxes, grids and surfaces of revolution, and PLY files.

Faces are counter-clockwise as seen from outside. Lengths are world units.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gpf.core import ply
from gpf.core.vectors import normalise

Vector = Sequence[float] | np.ndarray


@dataclass(frozen=True)
class Mesh:
    """A triangle mesh.

    Attributes
    ----------
    points: (N, 3).
    faces: indices of points, (M, 3).
    normals: one unit vector per point, (N, 3); None for a facetted mesh.
    uv: texture coordinates, (N, 2), or None.
    """

    points: np.ndarray
    faces: np.ndarray
    normals: np.ndarray | None = None
    uv: np.ndarray | None = None

    def transformed(self, matrix: np.ndarray) -> Mesh:
        """The mesh under an affine map (4, 4) that preserves orientation."""
        linear = np.asarray(matrix, dtype=float)[:3, :3]
        points = self.points @ linear.T + np.asarray(matrix, dtype=float)[:3, 3]
        normals = self.normals
        if normals is not None:
            normals = normalise(normals @ np.linalg.inv(linear))
        return replace(self, points=points, normals=normals)

    def smooth(self) -> Mesh:
        """The mesh with normals: at each point the mean of its faces' normals, weighted by area.

        Points in the same place with different indices keep a crease between them.
        """
        a, b, c = (self.points[self.faces[:, i]] for i in range(3))
        twice_area = np.cross(b - a, c - a)
        total = np.zeros_like(self.points)
        for i in range(3):
            np.add.at(total, self.faces[:, i], twice_area)
        return replace(self, normals=normalise(total))


def join(meshes: Sequence[Mesh]) -> Mesh:
    """Several meshes as one.

    Raises
    ------
    ValueError: some of the meshes have normals and others do not, or the same for uv.
    """
    first = np.cumsum([0] + [len(mesh.points) for mesh in meshes])
    faces = [mesh.faces + start for mesh, start in zip(meshes, first, strict=False)]

    def column(name: str) -> np.ndarray | None:
        found = [getattr(mesh, name) for mesh in meshes]
        if any(value is None for value in found):
            if any(value is not None for value in found):
                raise ValueError(f"some of the meshes have {name}, others do not")
            return None
        return np.concatenate(found)

    points = np.concatenate([mesh.points for mesh in meshes])
    return Mesh(points, np.concatenate(faces), column("normals"), column("uv"))


def strip(lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Two triangles for each quad between two rows of vertex indices, (2 (n - 1), 3)."""
    a, b, c, d = lower[:-1], lower[1:], upper[1:], upper[:-1]
    return np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])


def grid(rows: np.ndarray, closed: bool = False, uv: np.ndarray | None = None) -> Mesh:
    """A surface through rows of points (R, C, 3), with ``uv`` (R, C, 2).

    ``closed`` joins the last column to the first. From outside, columns run to the right and rows
    upwards.
    """
    count, columns = rows.shape[:2]
    index = np.arange(count * columns).reshape(count, columns)
    if closed:
        index = np.concatenate([index, index[:, :1]], axis=1)
    faces = np.concatenate([strip(index[i], index[i + 1]) for i in range(count - 1)])
    return Mesh(rows.reshape(-1, 3), faces, uv=None if uv is None else uv.reshape(-1, 2))


def quad(corner: Vector, right: Vector, up: Vector) -> Mesh:
    """A parallelogram with uv from (0, 0) at ``corner`` to (1, 1); it faces right × up."""
    c, r, u = (np.asarray(v, dtype=float) for v in (corner, right, up))
    uv = np.array([[[0, 0], [1, 0]], [[0, 1], [1, 1]]], dtype=float)
    return grid(np.array([[c, c + r], [c + u, c + r + u]]), uv=uv)


def box(lower: Vector, upper: Vector) -> Mesh:
    """A box that faces outwards; each of its six faces has uv from (0, 0) to (1, 1)."""
    low, high = np.asarray(lower, dtype=float), np.asarray(upper, dtype=float)
    sides = []
    for axis in range(3):
        a, b = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
        a, b = a * (high - low), b * (high - low)
        far = low + np.eye(3)[axis] * (high - low)
        sides += [quad(far, a, b), quad(low, b, a)]
    return join(sides)


def lathe(profile: np.ndarray, segments: int = 96) -> Mesh:
    """A surface of revolution about the y axis.

    ``profile`` (K, 2) lists (radius, y) along the outside, from the bottom up. A radius of 0 at an
    end closes the surface with a pole.
    """
    angle = 2 * np.pi * np.arange(segments) / segments
    ring = np.stack([np.sin(angle), np.zeros_like(angle), np.cos(angle)], axis=1)
    rows = np.array([radius * ring + [0, y, 0] for radius, y in profile])
    mesh = grid(rows, closed=True)
    faces = mesh.faces
    for row in (0, len(profile) - 1):
        if profile[row][0] == 0:  # all points of the ring coincide
            members = (faces >= row * segments) & (faces < (row + 1) * segments)
            faces = np.where(members, row * segments, faces)
    return _compact(Mesh(mesh.points, faces))


def _compact(mesh: Mesh) -> Mesh:
    """The mesh without faces that repeat a corner, and without points that no face uses."""
    a, b, c = mesh.faces.T
    faces = mesh.faces[(a != b) & (b != c) & (c != a)]
    used, index = np.unique(faces, return_inverse=True)
    return Mesh(mesh.points[used], index.reshape(-1, 3))


def write_ply(path: Path, mesh: Mesh) -> Path:
    """Write a binary PLY for Mitsuba, rounded to six decimals; return ``path``."""
    columns = {"x y z": mesh.points, "nx ny nz": mesh.normals, "u v": mesh.uv}
    # A sine's last bit may differ between machines, but not six decimals. + 0.0: no -0.0.
    rounded = {k: np.round(v, 6) + 0.0 for k, v in columns.items() if v is not None}
    ply.write_ply(path, rounded, mesh.faces)
    return path

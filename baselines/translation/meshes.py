"""The triangles of Mitsuba's shapes, in world space."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import mitsuba as mi
import numpy as np

from baselines.protocol import CannotServe
from gpf.modelling.meshes import Mesh

COARSE = {"Rectangle": (1, 1), "Disk": (1, 24), "Cylinder": (24, 1), "Sphere": (24, 12)}
"""Steps in u and v for the tessellation of Mitsuba's analytic shapes."""

FINE = {"Rectangle": (1, 1), "Disk": (1, 192), "Cylinder": (192, 1), "Sphere": (192, 96)}


def read_mesh(shape: mi.Shape, where: str, steps: Mapping[str, tuple[int, int]] = COARSE) -> Mesh:
    """The triangles of a shape, with normals if the shape is smooth.

    Raises
    ------
    CannotServe: shapes of this type are not supported.
    """
    values = mi.traverse(shape)
    kind = shape.class_name()
    if "faces" in values:
        points = np.array(values["vertex_positions"], dtype=float).reshape(-1, 3)
        faces = np.array(values["faces"], dtype=int).reshape(-1, 3)
        found = "vertex_normals" in values and len(values["vertex_normals"]) == points.size
        normals = np.array(values["vertex_normals"], float).reshape(-1, 3) if found else None
        mapped = (
            "vertex_texcoords" in values and 3 * len(values["vertex_texcoords"]) == 2 * points.size
        )
        uv = np.array(values["vertex_texcoords"], float).reshape(-1, 2) if mapped else None
        mesh = face_along_normals(Mesh(points, faces, normals, uv))
    elif kind in steps:
        to_world = np.array(values["to_world"].matrix, dtype=float).reshape(4, 4)
        mesh = face_along_normals(tessellate(kind, *steps[kind]).transformed(to_world))
    else:
        raise CannotServe(
            f"{where}: {shape.id()}",
            f"shapes of type {kind} are not supported",
            "Replace it with a mesh, or leave the system out for this scene.",
        )
    return _turn_inside_out(mesh) if shape.has_flipped_normals() else mesh


def facet_normals(mesh: Mesh) -> np.ndarray:
    """Unit normals of the facets, (M, 3); a facet is counter-clockwise as seen from its normal's
    side. 0 for facets without area."""
    a, b, c = (mesh.points[mesh.faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    return normal / np.where(length > 0, length, 1)


def tessellate(kind: str, steps_u: int, steps_v: int) -> Mesh:
    """A shape in its own coordinates: radius 1 around the origin, the cylinder from z = 0 to 1."""
    u, v = (a.ravel() for a in np.mgrid[0 : 1 : 1j * (steps_u + 1), 0 : 1 : 1j * (steps_v + 1)])
    up = np.stack([0 * u, 0 * u, 0 * u + 1], axis=1)
    if kind == "Rectangle":
        points, normals = np.stack([2 * u - 1, 2 * v - 1, 0 * u], axis=1), up
    elif kind == "Disk":
        points, normals = u[:, None] * _circle(v), up
    elif kind == "Cylinder":
        normals = _circle(u)
        points = normals + v[:, None] * up
    else:
        normals = np.sin(np.pi * v)[:, None] * _circle(u) + np.cos(np.pi * v)[:, None] * up
        points = normals
    corner = ((steps_v + 1) * np.arange(steps_u)[:, None] + np.arange(steps_v)).ravel()
    a, b, c, d = corner, corner + steps_v + 1, corner + steps_v + 2, corner + 1
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    p = points[faces]
    # At poles and in the middle of a disk, half of the facets have no area.
    size = np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1)
    return Mesh(points, faces[size > 1e-9], normals, np.stack([u, v], axis=1))


def _circle(turns: np.ndarray) -> np.ndarray:
    angle = 2 * np.pi * turns
    return np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)


def face_along_normals(mesh: Mesh) -> Mesh:
    """The mesh with facets turned towards their normals, since a reflection flips them."""
    if mesh.normals is None:
        return mesh
    along = (facet_normals(mesh) * mesh.normals[mesh.faces].sum(axis=1)).sum(axis=1)
    return replace(mesh, faces=np.where(along[:, None] < 0, mesh.faces[:, ::-1], mesh.faces))


def _turn_inside_out(mesh: Mesh) -> Mesh:
    normals = None if mesh.normals is None else -mesh.normals
    return replace(mesh, faces=mesh.faces[:, ::-1], normals=normals)

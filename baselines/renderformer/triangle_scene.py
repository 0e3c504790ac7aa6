"""A Mitsuba scene as a list of coloured, emitting triangles, for learned renderers.

Scenes that such a list cannot represent are refused
(:mod:`baselines.renderformer.triangle_materials`).
"""

from __future__ import annotations

from dataclasses import dataclass

import mitsuba as mi
import numpy as np

from baselines.protocol import CannotServe
from baselines.renderformer.triangle_materials import (
    Material,
    read_material,
    read_radiance,
    refuse_what_triangles_lack,
)
from gpf.modelling.meshes import Mesh

# Steps in u and v for the tessellation of Mitsuba's analytic shapes.
_STEPS = {"Rectangle": (1, 1), "Disk": (1, 24), "Cylinder": (24, 1), "Sphere": (24, 12)}


@dataclass(frozen=True)
class Surface:
    """A mesh of one material. ``radiance`` (3,): emitted radiance, W/(m² sr)."""

    name: str
    mesh: Mesh
    material: Material
    radiance: np.ndarray

    @property
    def glows(self) -> bool:
        """Whether it is a lamp."""
        return bool((self.radiance > 0).any())


@dataclass(frozen=True)
class Triangles:
    """Triangles with their materials.

    Attributes
    ----------
    corners: (N, 3, 3); the second index is the corner.
    normals: unit vectors at the corners, (N, 3, 3).
    diffuse, specular: reflectances, (N, 3).
    roughness: (N,).
    radiance: emitted radiance, (N, 3).
    """

    corners: np.ndarray
    normals: np.ndarray
    diffuse: np.ndarray
    specular: np.ndarray
    roughness: np.ndarray
    radiance: np.ndarray

    def __len__(self) -> int:
        return len(self.corners)

    @property
    def glow(self) -> np.ndarray:
        """Whether each triangle is a lamp, (N,) bool."""
        return np.asarray((self.radiance > 0).any(axis=1))

    def take(self, index: np.ndarray) -> Triangles:
        """The triangles with the given indices, in this order; indices may repeat."""
        return Triangles(**{name: value[index] for name, value in vars(self).items()})


def read_surfaces(scene: mi.Scene, where: str) -> list[Surface]:
    """The surfaces of a scene.

    Raises
    ------
    CannotServe: triangles with one colour each cannot represent the scene.
    """
    refuse_what_triangles_lack(scene, where)
    surfaces = []
    for shape in scene.shapes():
        name = shape.id() or shape.class_name()
        radiance = read_radiance(shape.emitter()) if shape.is_emitter() else np.zeros(3)
        material = read_material(shape.bsdf(), where)
        surfaces.append(Surface(name, read_mesh(shape, where), material, radiance))
    return surfaces


def read_mesh(shape: mi.Shape, where: str) -> Mesh:
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
        mesh = _face_along_normals(Mesh(points, faces, normals))
    elif kind in _STEPS:
        to_world = np.array(values["to_world"].matrix, dtype=float).reshape(4, 4)
        mesh = _face_along_normals(_tessellate(kind).transformed(to_world))
    else:
        raise CannotServe(
            f"{where}: {shape.id()}",
            f"shapes of type {kind} are not supported",
            "Replace it with a mesh, or leave the system out for this scene.",
        )
    return _turn_inside_out(mesh) if shape.has_flipped_normals() else mesh


def join_triangles(surfaces: list[Surface]) -> Triangles:
    """The triangles of all surfaces, in the surfaces' order."""
    parts = []
    for surface in surfaces:
        mesh, count = surface.mesh, len(surface.mesh.faces)
        corners = mesh.points[mesh.faces]
        flat = np.repeat(facet_normals(mesh)[:, None], 3, axis=1)
        parts.append(
            Triangles(
                corners,
                flat if mesh.normals is None else mesh.normals[mesh.faces],
                np.tile(surface.material.diffuse, (count, 1)),
                np.tile(surface.material.specular, (count, 1)),
                np.full(count, surface.material.roughness),
                np.tile(surface.radiance, (count, 1)),
            )
        )
    names = vars(parts[0])
    return Triangles(**{n: np.concatenate([vars(part)[n] for part in parts]) for n in names})


def facet_normals(mesh: Mesh) -> np.ndarray:
    """Unit normals of the facets, (M, 3); a facet is counter-clockwise as seen from its normal's
    side. 0 for facets without area."""
    a, b, c = (mesh.points[mesh.faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    return normal / np.where(length > 0, length, 1)


def _tessellate(kind: str) -> Mesh:
    """A shape in its own coordinates: radius 1 around the origin, the cylinder from z = 0 to 1."""
    steps_u, steps_v = _STEPS[kind]
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
    return Mesh(points, faces[size > 1e-9], normals)


def _circle(turns: np.ndarray) -> np.ndarray:
    angle = 2 * np.pi * turns
    return np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)


def _face_along_normals(mesh: Mesh) -> Mesh:
    """The mesh with facets turned towards their normals, since a reflection flips them."""
    if mesh.normals is None:
        return mesh
    along = (facet_normals(mesh) * mesh.normals[mesh.faces].sum(axis=1)).sum(axis=1)
    faces = np.where(along[:, None] < 0, mesh.faces[:, ::-1], mesh.faces)
    return Mesh(mesh.points, faces, mesh.normals)


def _turn_inside_out(mesh: Mesh) -> Mesh:
    normals = None if mesh.normals is None else -mesh.normals
    return Mesh(mesh.points, mesh.faces[:, ::-1], normals)

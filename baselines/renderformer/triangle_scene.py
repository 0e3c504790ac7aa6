"""A Mitsuba scene as a list of coloured, emitting triangles, for learned renderers.

Scenes that such a list cannot represent are refused
(:mod:`baselines.renderformer.triangle_materials`).
"""

from __future__ import annotations

from dataclasses import dataclass

import mitsuba as mi
import numpy as np

from baselines.renderformer.triangle_materials import (
    Material,
    read_material,
    read_radiance,
    refuse_what_triangles_lack,
)
from baselines.translation.meshes import facet_normals, read_mesh
from gpf.modelling.meshes import Mesh


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

"""The surfaces of a scene that light can be baked on, as triangles.

Light is baked on one side of each surface: the side that its normals point to, which Mitsuba calls
the front. A two-sided surface has the light of its front only.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace

import mitsuba as mi
import numpy as np

from gpf.baking.curved import STEPS, Curved


@dataclass(frozen=True)
class Surface:
    """The triangles of a shape, counter-clockwise as seen from the front.

    Attributes
    ----------
    name: the shape's id or, without one, its class; unique in the scene.
    points: world units, (N, 3) float32.
    faces: indices of points, (M, 3) uint32.
    normals: unit vectors of a smooth shape, (N, 3) float32; None for a faceted one.
    uv: the scene's own texture coordinates, (N, 2) float32, or None.
    curved: what the triangles approximate; None for a mesh.
    """

    name: str
    shape: mi.Shape
    points: np.ndarray
    faces: np.ndarray
    normals: np.ndarray | None
    uv: np.ndarray | None
    curved: Curved | None = None

    @property
    def corners(self) -> np.ndarray:
        """The corners of the triangles, world units, (M, 3, 3) float32."""
        return np.asarray(self.points[self.faces])

    @property
    def areas(self) -> np.ndarray:
        """The areas of the triangles, (M,) float64."""
        return np.asarray(np.linalg.norm(self._crossed, axis=1) / 2)

    @property
    def area(self) -> float:
        """The area of all triangles."""
        return float(self.areas.sum())

    @property
    def face_normals(self) -> np.ndarray:
        """Unit normals of the triangles, (M, 3) float32; 0 for those without area."""
        length = 2 * self.areas[:, None]
        return np.asarray(self._crossed / np.where(length > 0, length, 1), np.float32)

    @property
    def _crossed(self) -> np.ndarray:
        a, b, c = self.corners.transpose(1, 0, 2).astype(np.float64)
        return np.cross(b - a, c - a)

    @property
    def two_sided(self) -> bool:
        """Whether the back has a diffuse component as well, whose light is not baked."""
        return bool(mi.has_flag(self.shape.bsdf().flags(), mi.BSDFFlags.BackSide))

    def at(self, faces: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions and geometric normals of points on triangles, (P, 3) float32 each.

        Parameters
        ----------
        faces: the triangle of each point, (P,).
        weights: its barycentric coordinates, (P, 3).
        """
        p = np.einsum("pk,pki->pi", weights, self.corners[faces])
        if self.curved is not None:
            return self.curved.nearest(p)
        return p.astype(np.float32), self.face_normals[faces]


def read_surfaces(scene: mi.Scene) -> tuple[list[Surface], dict[str, str]]:
    """The surfaces that light can be baked on, and why others are left out, by their names."""
    surfaces: list[Surface] = []
    left_out: dict[str, str] = {}
    for name, shape in _named(scene):
        if not _is_supported(shape):
            left_out[name] = f"shapes of type {shape.class_name()} are not supported"
        elif not _has(shape, mi.BSDFFlags.Diffuse):
            left_out[name] = "it has no diffuse component"
        elif (surface := _read(name, shape)).area > 0:
            surfaces.append(surface)
        else:
            left_out[name] = "it has no area"
    return surfaces, left_out


def read_specular_surfaces(scene: mi.Scene) -> list[Surface]:
    """The surfaces that only reflect and transmit, such as glass and metal."""
    flags = mi.BSDFFlags
    visible = flags.DeltaReflection, flags.DeltaTransmission, flags.Glossy
    found = (
        _read(name, shape)
        for name, shape in _named(scene)
        if _is_supported(shape)
        and not _has(shape, mi.BSDFFlags.Diffuse)
        and any(_has(shape, flag) for flag in visible)
    )
    return [surface for surface in found if surface.area > 0]


def _named(scene: mi.Scene) -> Iterator[tuple[str, mi.Shape]]:
    """The shapes of a scene with unique names."""
    taken: Counter[str] = Counter()
    for shape in scene.shapes():
        plain = shape.id() or shape.class_name()
        taken[plain] += 1
        yield plain if taken[plain] == 1 else f"{plain} ({taken[plain]})", shape


def _is_supported(shape: mi.Shape) -> bool:
    return isinstance(shape, mi.Mesh) or shape.class_name() in STEPS


def _has(shape: mi.Shape, flag: mi.BSDFFlags) -> bool:
    bsdf = shape.bsdf()
    return bsdf is not None and bool(mi.has_flag(bsdf.flags(), flag))


def _read(name: str, shape: mi.Shape) -> Surface:
    if not isinstance(shape, mi.Mesh):
        surface = _divide(name, shape, *STEPS[shape.class_name()])
        return replace(surface, faces=_along_normals(surface))

    def rows(buffer: mi.Float, width: int) -> np.ndarray:
        return np.array(buffer, dtype=np.float32).reshape(-1, width)

    points = rows(shape.vertex_positions_buffer(), 3)
    faces = np.array(shape.faces_buffer(), dtype=np.uint32).reshape(-1, 3)
    smooth = shape.has_vertex_normals() and not shape.has_face_normals()
    normals = rows(shape.vertex_normals_buffer(), 3) if smooth else None
    uv = rows(shape.vertex_texcoords_buffer(), 2) if shape.has_vertex_texcoords() else None
    surface = Surface(name, shape, points, faces, normals, uv)
    surface = replace(surface, faces=_along_normals(surface))
    if not shape.has_flipped_normals():
        return surface
    normals = None if normals is None else -normals
    return replace(surface, faces=surface.faces[:, ::-1], normals=normals)


def _divide(name: str, shape: mi.Shape, across: int, along: int) -> Surface:
    """A grid of triangles over the parameters of an analytic shape."""
    grid = np.mgrid[0 : 1 : 1j * (across + 1), 0 : 1 : 1j * (along + 1)]
    uv = grid.reshape(2, -1).T.astype(np.float32)
    corner = ((along + 1) * np.arange(across)[:, None] + np.arange(along)).ravel()
    a, b, c, d = corner, corner + along + 1, corner + along + 2, corner + 1
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.uint32)
    curved = Curved.read(shape)
    points, normals = curved.nearest(curved.place(uv))
    surface = Surface(name, shape, points, faces, normals, uv, curved)
    # At poles and in the middle of a disk, half of the triangles have no area.
    areas = surface.areas
    return replace(surface, faces=faces[areas > 1e-5 * areas.max()])


def _along_normals(surface: Surface) -> np.ndarray:
    """The triangles, turned to the side of the normals: a reflection turns them over."""
    if surface.normals is None:
        return surface.faces
    along = surface.face_normals * surface.normals[surface.faces].sum(axis=1)
    return np.where(along.sum(axis=1)[:, None] < 0, surface.faces[:, ::-1], surface.faces)

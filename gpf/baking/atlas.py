"""Light-map coordinates: one page on which the triangles of all surfaces have places of their own.

The package xatlas cuts surfaces into charts that can be flattened, and packs them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby

import numpy as np

from gpf.baking.surfaces import Surface
from gpf.baking.xatlas_process import Flat, Mesh, flatten
from gpf.core.errors import UserError

LARGEST = 16384
"""Largest width and height of a page, texels."""

# xatlas's time grows with the square of a mesh's triangles: for 184,000 of them, 5 s instead of 57,
# and a quarter of the charts.
AT_ONCE = 4000
"""Most triangles of a mesh that are cut together."""


@dataclass(frozen=True)
class Chart:
    """The light-map coordinates of a surface.

    The vertices are those of the surface, repeated where charts meet; the triangles are in the same
    order.

    Attributes
    ----------
    vertices: the surface's vertex that each of these repeats, (V,).
    faces: indices of these vertices, (M, 3).
    uv: coordinates on the page, in [0, 1], (V, 2) float32. As in Mitsuba and glTF, v is 0 at the
        top of the image.
    """

    surface: Surface
    vertices: np.ndarray
    faces: np.ndarray
    uv: np.ndarray


@dataclass(frozen=True)
class Atlas:
    """The page of a scene.

    Attributes
    ----------
    size: width and height, texels.
    texels_per_unit: density, texels per world unit.
    """

    charts: list[Chart]
    size: tuple[int, int]
    texels_per_unit: float

    @cached_property
    def triangles(self) -> np.ndarray:
        """The corners of all triangles, surface after surface, in texels, (T, 3, 2)."""
        corners = [chart.uv[chart.faces] for chart in self.charts]
        return np.concatenate(corners).astype(np.float64) * self.size

    def at(self, triangles: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions, world units, and geometric normals of points on triangles of the page,
        (P, 3) float32 each; the arguments are those of :meth:`Surface.at`."""
        p, n = (np.zeros((len(triangles), 3), np.float32) for _ in range(2))
        first = 0
        for chart in self.charts:
            count = len(chart.faces)
            here = np.flatnonzero((triangles >= first) & (triangles < first + count))
            if len(here):
                p[here], n[here] = chart.surface.at(triangles[here] - first, weights[here])
            first += count
        return p, n


def unwrap(
    surfaces: Sequence[Surface], size: int | None, texels_per_unit: float | None = None
) -> Atlas:
    """Light-map coordinates for surfaces, on one page.

    Parameters
    ----------
    size: width and height of the page; None to let ``texels_per_unit`` decide.

    Raises
    ------
    UserError: xatlas is missing, or the charts do not fit on the page, or it would be larger than
        :data:`LARGEST`.
    """
    side = sum(surface.area for surface in surfaces) ** 0.5
    density = texels_per_unit or (size or LARGEST) / side
    if density * side > LARGEST:
        raise _too_fine(density, density * side)
    pieces = [piece for surface in surfaces for piece in _divide(surface)]
    page = flatten([piece.mesh(density) for piece in pieces], size)
    if size is None and max(page.size) > LARGEST:
        raise _too_fine(density, max(page.size))
    if size is not None and max(page.size) > size:
        raise UserError(
            f"--size {size}",
            f"is too small for the {page.charts} parts of the surfaces",
            "Give a larger size, or bake --vertex-colours.",
        )
    extent = page.size if size is None else (size, size)
    return Atlas(_join(pieces, page.meshes, extent), extent, page.scale * density)


def _too_fine(density: float, side: float) -> UserError:
    return UserError(
        f"--texels-per-unit {density:g}",
        f"needs a map of about {side:g}x{side:g} texels",
        f"Give a smaller number: the largest map has {LARGEST}x{LARGEST}.",
    )


@dataclass(frozen=True)
class _Piece:
    """Triangles of a surface that are cut into charts together.

    Attributes
    ----------
    triangles: their indices, (M,).
    vertices: the surface's vertices that they use, (V,).
    faces: indices of these vertices, (M, 3).
    """

    surface: Surface
    triangles: np.ndarray
    vertices: np.ndarray
    faces: np.ndarray

    def mesh(self, density: float) -> Mesh:
        """For xatlas; ``density``: texels per unit of length."""
        points = density * self.surface.points[self.vertices]
        return Mesh(points.astype(np.float32), self.faces)


def _divide(surface: Surface) -> list[_Piece]:
    """Pieces of at most :data:`AT_ONCE` triangles, halved across their longest extent."""
    middles = surface.corners.mean(axis=1)
    pieces, rest = [], [np.arange(len(surface.faces))]
    while rest:
        triangles = rest.pop()
        if len(triangles) > AT_ONCE:
            axis = np.ptp(middles[triangles], axis=0).argmax()
            order = np.argsort(middles[triangles, axis], kind="stable")
            rest += np.array_split(triangles[order], 2)
            continue
        vertices, faces = np.unique(surface.faces[triangles], return_inverse=True)
        faces = faces.reshape(-1, 3).astype(np.uint32)
        pieces.append(_Piece(surface, triangles, vertices, faces))
    return pieces


def _join(pieces: Sequence[_Piece], flat: Sequence[Flat], size: tuple[int, int]) -> list[Chart]:
    """The charts of the surfaces, on a page of a size in texels."""
    charts = []
    both = zip(pieces, flat, strict=True)
    for _, group in groupby(both, lambda pair: id(pair[0].surface)):
        own = list(group)
        surface = own[0][0].surface
        faces, first = np.empty_like(surface.faces), 0
        for piece, part in own:
            faces[piece.triangles] = part.faces + first
            first += len(part.vertices)
        vertices = np.concatenate([piece.vertices[part.vertices] for piece, part in own])
        uv = np.concatenate([part.uv for _, part in own]) / size
        charts.append(Chart(surface, vertices, faces, uv.astype(np.float32)))
    return charts

"""Light-map coordinates: one page on which the triangles of all surfaces have places of their own.

The package xatlas cuts surfaces into charts that can be flattened, and packs them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from typing import Any

import numpy as np

from gpf.baking.surfaces import Surface
from gpf.core.errors import UserError

PADDING = 4
"""Texels between charts: each has two around it of its own."""

LARGEST = 16384
"""Largest width and height of a page, texels."""

# Twice xatlas's own: a third of the charts on a teapot's lid, and no more distortion.
MAX_COST = 4.0

# xatlas's time grows with the square of a mesh's triangles: for 184,000 of them, 5 s instead of 57,
# and a quarter of the charts.
AT_ONCE = 4000
"""Most triangles of a mesh that are cut together."""

# How often charts are packed more tightly until they fit on a page.
TRIES = 20


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
    xatlas = _xatlas()
    parts = [_cut(xatlas, piece, density) for surface in surfaces for piece in _divide(surface)]
    extent = _pack(xatlas, parts, 1)
    if size is None:
        if max(extent) > LARGEST:
            raise _too_fine(density, max(extent))
        return Atlas(_join(parts, extent), extent, density)
    share = 1.0
    for _ in range(TRIES):
        if max(extent) <= size:
            return Atlas(_join(parts, (size, size)), (size, size), share * density)
        share *= min(size / max(extent), 0.98)
        extent = _pack(xatlas, parts, share)
    raise UserError(
        f"--size {size}",
        f"is too small for the {sum(part.charts for part in parts)} parts of the surfaces",
        "Give a larger size, or bake --vertex-colours.",
    )


def _too_fine(density: float, side: float) -> UserError:
    return UserError(
        f"--texels-per-unit {density:g}",
        f"needs a map of about {side:g}x{side:g} texels",
        f"Give a smaller number: the largest map has {LARGEST}x{LARGEST}.",
    )


def _xatlas() -> Any:
    try:
        import xatlas
    except ImportError as error:
        raise UserError(
            "xatlas",
            "is not installed, so surfaces cannot be unwrapped",
            "Run `pip install xatlas`, or bake --vertex-colours.",
        ) from error
    return xatlas


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


@dataclass
class _Cut:
    """A piece with its charts.

    Attributes
    ----------
    vertices, faces: as in :class:`Chart`.
    flat: the charts before they are packed, texels, (V, 2) float32.
    charts: their number.
    uv: where they are packed, texels, (V, 2).
    """

    piece: _Piece
    vertices: np.ndarray
    faces: np.ndarray
    flat: np.ndarray
    charts: int
    uv: np.ndarray


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


def _cut(xatlas: Any, piece: _Piece, density: float) -> _Cut:
    """Cut a piece into flat charts; ``density``: texels per unit of length."""
    # Each in an atlas of its own: with many meshes in one, `add_mesh` crashes now and then.
    atlas = xatlas.Atlas()
    # In texels: xatlas ignores triangles of an area below 1e-7.
    points = density * piece.surface.points[piece.vertices]
    atlas.add_mesh(points.astype(np.float32), piece.faces)
    (again, faces, uv), count = _generate(xatlas, atlas, 1)[0], atlas.chart_count
    return _Cut(piece, piece.vertices[again], faces, uv, count, uv)


def _pack(xatlas: Any, parts: Sequence[_Cut], share: float) -> tuple[int, int]:
    """Pack all charts on a page, at a density relative to theirs; return its width and height."""
    atlas = xatlas.Atlas()
    for part in parts:
        atlas.add_uv_mesh(part.flat, part.faces)
    for part, (again, _, uv) in zip(parts, _generate(xatlas, atlas, share), strict=True):
        part.uv = np.empty_like(part.flat)
        part.uv[again] = uv
    return atlas.width, atlas.height


def _generate(xatlas: Any, atlas: Any, density: float) -> list[tuple[np.ndarray, ...]]:
    """Cut and pack what was added to an atlas. For each mesh: the vertices that its vertices
    repeat, its triangles, and its coordinates in texels."""
    cutting, packing = xatlas.ChartOptions(), xatlas.PackOptions()
    cutting.max_cost = MAX_COST
    packing.padding, packing.texels_per_unit = PADDING, density
    atlas.generate(cutting, packing)
    meshes = [atlas.get_mesh(k) for k in range(atlas.mesh_count)]
    size = np.array([atlas.width, atlas.height], np.float32)
    return [(vertices, faces, uv * size) for vertices, faces, uv in meshes]


def _join(parts: Sequence[_Cut], size: tuple[int, int]) -> list[Chart]:
    """The charts of the surfaces, on a page of a size in texels."""
    charts = []
    for _, group in groupby(parts, lambda part: id(part.piece.surface)):
        own = list(group)
        surface = own[0].piece.surface
        faces, first = np.empty_like(surface.faces), 0
        for part in own:
            faces[part.piece.triangles] = part.faces + first
            first += len(part.vertices)
        vertices = np.concatenate([part.vertices for part in own])
        uv = np.concatenate([part.uv for part in own]) / size
        charts.append(Chart(surface, vertices, faces, uv.astype(np.float32)))
    return charts

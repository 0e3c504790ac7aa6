"""Light-map coordinates: one page on which the triangles of all surfaces have places of their own.

The package xatlas cuts surfaces into charts that can be flattened, and packs them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
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
    package = _xatlas()
    atlas = package.Atlas()
    for surface in surfaces:
        # In texels: xatlas ignores triangles of an area below 1e-7.
        atlas.add_mesh((density * surface.points).astype(np.float32), surface.faces)
    packed = first = _Packed.make(atlas, package, 1)
    if size is None:
        if max(packed.extent) > LARGEST:
            raise _too_fine(density, max(packed.extent))
        return Atlas(packed.on_page(surfaces, packed.extent), packed.extent, density)
    share = 1.0
    for _ in range(TRIES):
        largest = max(packed.extent)
        if largest <= size:
            return Atlas(packed.on_page(surfaces, (size, size)), (size, size), share * density)
        share *= min(size / largest, 0.98)
        packed = first.again(package, share)
    raise UserError(
        f"--size {size}",
        f"is too small for the {packed.xatlas.chart_count} parts into which surfaces are cut",
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
class _Packed:
    """Charts on a page.

    Attributes
    ----------
    xatlas: the atlas as the package has it.
    vertices, faces, uv: for each surface as in :class:`Chart`, but uv in texels.
    """

    xatlas: Any
    vertices: list[np.ndarray]
    faces: list[np.ndarray]
    uv: list[np.ndarray]

    @classmethod
    def make(cls, atlas: Any, package: Any, density: float) -> _Packed:
        """Cut what was added to an atlas, and pack it at a density, texels per unit of length."""
        cutting, packing = package.ChartOptions(), package.PackOptions()
        cutting.max_cost = MAX_COST
        packing.padding, packing.texels_per_unit = PADDING, density
        atlas.generate(cutting, packing)
        meshes = [atlas.get_mesh(k) for k in range(atlas.mesh_count)]
        vertices, faces, uv = (list(parts) for parts in zip(*meshes, strict=True))
        return cls(atlas, vertices, faces, [part * [atlas.width, atlas.height] for part in uv])

    @property
    def extent(self) -> tuple[int, int]:
        """Width and height, texels."""
        return self.xatlas.width, self.xatlas.height

    def again(self, package: Any, density: float) -> _Packed:
        """The same charts, packed at a density relative to this one; quick, unlike cutting."""
        atlas = package.Atlas()
        # All at once: xatlas takes meshes for the same if they are at the same place in memory.
        flat = [part.astype(np.float32) for part in self.uv]
        for uv, faces in zip(flat, self.faces, strict=True):
            atlas.add_uv_mesh(uv, faces)
        packed = _Packed.make(atlas, package, density)
        pairs = zip(self.vertices, packed.vertices, strict=True)
        return replace(packed, vertices=[first[again] for first, again in pairs])

    def on_page(self, surfaces: Sequence[Surface], size: tuple[int, int]) -> list[Chart]:
        """The charts on a page of a size, texels."""
        parts = zip(surfaces, self.vertices, self.faces, self.uv, strict=True)
        return [Chart(s, v, f, (uv / size).astype(np.float32)) for s, v, f, uv in parts]

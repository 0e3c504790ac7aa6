"""Builds the water of a basin: its rippled surface, its sides and its bottom.

The basin is |x| <= 1.5, |z| <= 1, FLOOR <= y <= 0.3. The water reaches almost to its walls: its
sides and its bottom, which do not refract, are GAP before them, so that the water has a boundary
everywhere. The builder writes the same bytes every time.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from gpf.modelling.meshes import Mesh, grid, join, quad, write_ply
from gpf.modelling.textures import write_png
from gpf.modelling.waves import spread_waves, water_surface
from scenes.modelling.paving import tiles

HALF_X, HALF_Z, FLOOR = 1.5, 1.0, -1.2
GAP = 0.001
CELLS_X, CELLS_Z = 192, 128  # 49,152 triangles

# (wavelength, root-mean-square slope, number of directions)
BANDS = ((1.3, 0.03, 3), (0.6, 0.05, 5), (0.3, 0.05, 7))

PALE = [(0.0, (0.45, 0.66, 0.72)), (0.5, (0.55, 0.75, 0.79)), (1.0, (0.64, 0.82, 0.84))]
GROUT = (0.74, 0.78, 0.78)


def surface() -> Mesh:
    """The surface of the water."""
    x = np.linspace(-HALF_X + GAP, HALF_X - GAP, CELLS_X + 1)
    z = np.linspace(HALF_Z - GAP, -HALF_Z + GAP, CELLS_Z + 1)
    return water_surface(spread_waves(BANDS), x, z)


def sides() -> Mesh:
    """The four sides of the water, down from the edge of its surface, and its bottom; outwards."""
    top = surface().points.reshape(CELLS_Z + 1, CELLS_X + 1, 3)
    bottom = FLOOR + GAP
    # The edge of the surface, seen from outside, from left to right: south, east, north, west.
    edges = top[0], top[:, -1], top[-1, ::-1], top[::-1, 0]
    walls = [grid(np.stack([edge * [1, 0, 1] + [0, bottom, 0], edge])) for edge in edges]
    x, z = HALF_X - GAP, HALF_Z - GAP
    below = quad(np.array([-x, bottom, -z]), np.array([2 * x, 0, 0]), np.array([0, 0, 2 * z]))
    return join([replace(mesh, normals=None, uv=None) for mesh in (*walls, below)])


def build(folder: Path) -> list[Path]:
    """Write ``meshes`` and ``textures`` below ``folder``; return the paths of their files."""
    made = [
        write_ply(folder / "meshes/surface.ply", surface()),
        write_ply(folder / "meshes/sides.ply", sides()),
    ]
    return [*made, write_png(folder / "textures/tiles.png", tiles(10, 10, 48, PALE, GROUT, seed=1))]

"""Builds the water of this scene: a wavy surface and the flat sheet that closes it at z = 1.

The box is x, z in [-1, 1], y in [0, 2], open at +z. The water fills it from the floor up to the
surface. Two meshes together bound the water, with normals outwards (surface up, sheet towards +z),
so that a dielectric's ``int_ior`` is inside the water:

- ``surface.ply``: a height field y = h(x, z) with analytic normals, over the whole box;
- ``sheet.ply``: the part of the plane z = 1 below the surface's edge. It has the vertices of that
  edge, bit for bit, so there is neither a gap nor an overlap between the two.

Both reach ``MARGIN`` into the walls, the floor and the back, which are opaque, so there is no slit
along the water line. There are no random numbers: the builder writes the same bytes every time.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from gpf.modelling.meshes import grid, write_ply
from gpf.modelling.waves import GOLDEN, sum_waves, upward_normals

CELLS = 224  # along x and along z: 2 * 224 * 224 = 100,352 triangles
MARGIN = 0.001  # how far the water reaches into the walls
LOWEST, HIGHEST = 1.326, 1.667  # of the surface

# (wavelength, root-mean-square amplitude before the heights are scaled, number of directions).
# A crest with the radius of curvature R is a lens of the focal length 2.25 R (IOR 1.8): the middle
# bands focus near the floor, the long band tilts the pattern, the short ones add its filaments.
BANDS = ((1.7, 1.0, 3), (0.95, 0.75, 5), (0.55, 0.34, 7), (0.31, 0.11, 9), (0.17, 0.03, 11))


def waves() -> np.ndarray:
    """Sine waves as rows (k_x, k_z, amplitude, phase), spread evenly by the golden ratio."""
    rows = []
    for wavelength, amplitude, count in BANDS:
        for i in range(count):
            n = len(rows) + 1
            angle = 2 * np.pi * (n * GOLDEN % 1)
            # Wavelengths differ by up to 15% from the band's, so that no two waves are equal.
            k = 2 * np.pi / (wavelength * (0.85 + 0.3 * ((i + 0.5) * GOLDEN % 1)))
            phase = 2 * np.pi * (n * n * GOLDEN % 1)
            rows.append((k * np.cos(angle), k * np.sin(angle), amplitude / count**0.5, phase))
    return np.array(rows)


def heights(x: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Heights (len(z), len(x)) and unit normals (len(z), len(x), 3) on the grid z by x.

    The sum of waves is scaled so that its extremes on the grid are LOWEST and HIGHEST. The normal
    of y = h is (-dh/dx, 1, -dh/dz), normalised.
    """
    total, slope_x, slope_z = sum_waves(waves(), x, z)
    scale = (HIGHEST - LOWEST) / (total.max() - total.min())
    height = LOWEST + scale * (total - total.min())
    normal = upward_normals(scale * slope_x, scale * slope_z)
    # A sine may differ in its last bit between machines; six decimals do not.
    return np.round(height, 6), np.round(normal, 6)


def build(folder: Path) -> list[Path]:
    """Write ``meshes/surface.ply`` and ``meshes/sheet.ply`` below ``folder``; return the paths."""
    x = np.round(np.linspace(-1 - MARGIN, 1 + MARGIN, CELLS + 1), 6)
    z = np.round(np.linspace(1, -1 - MARGIN, CELLS + 1), 6)  # row 0 is the edge at the sheet
    height, normal = heights(x, z)
    surface = np.stack([np.tile(x, (len(z), 1)), height, np.tile(z[:, None], len(x))], axis=-1)
    edge = surface[0]
    bottom = edge * [1, 0, 1] - [0, MARGIN, 0]
    skin = replace(grid(surface), normals=normal.reshape(-1, 3))
    meshes = folder / "meshes"
    return [
        write_ply(meshes / "surface.ply", skin),
        write_ply(meshes / "sheet.ply", grid(np.stack([bottom, edge]))),
    ]

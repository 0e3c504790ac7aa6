"""Water with ripples: sums of sine waves as height fields y = h(x, z)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gpf.core.vectors import normalise
from gpf.modelling.meshes import Mesh, grid

GOLDEN = (5**0.5 - 1) / 2

GRAVITY = 9.81  # m/s²

Band = tuple[float, float, int]
"""A wavelength, the root-mean-square slope of its waves together, and their number."""


def spread_waves(bands: Sequence[Band]) -> np.ndarray:
    """Sine waves as rows (k_x, k_z, amplitude, phase), spread evenly by the golden ratio."""
    rows: list[tuple[float, ...]] = []
    for wavelength, slope, count in bands:
        for i in range(count):
            n = len(rows) + 1
            angle = 2 * np.pi * (n * GOLDEN % 1)
            # Wavelengths differ by up to 20% from the band's, so that no two waves are equal.
            k = 2 * np.pi / (wavelength * (0.8 + 0.4 * ((i + 0.5) * GOLDEN % 1)))
            phase = 2 * np.pi * (n * n * GOLDEN % 1)
            amplitude = slope / k * (2 / count) ** 0.5
            rows.append((k * np.cos(angle), k * np.sin(angle), amplitude, phase))
    return np.array(rows)


def after(waves: np.ndarray, seconds: float) -> np.ndarray:
    """The same waves later: each runs along its k as in deep water, with ω² = g k, for lengths in
    metres."""
    later = waves.copy()
    later[:, 3] -= np.sqrt(GRAVITY * np.hypot(waves[:, 0], waves[:, 1])) * seconds
    return later


def sum_waves(
    waves: np.ndarray, x: np.ndarray, z: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Heights and slopes dh/dx and dh/dz of a sum of waves on the grid z by x, (Z, X) each."""
    height, slope_x, slope_z = (np.zeros((len(z), len(x))) for _ in range(3))
    for k_x, k_z, amplitude, phase in waves:
        angle = k_x * x[None, :] + k_z * z[:, None] + phase
        height += amplitude * np.sin(angle)
        slope_x += amplitude * k_x * np.cos(angle)
        slope_z += amplitude * k_z * np.cos(angle)
    return height, slope_x, slope_z


def upward_normals(slope_x: np.ndarray, slope_z: np.ndarray) -> np.ndarray:
    """Unit normals (-dh/dx, 1, -dh/dz), normalised, (Z, X, 3)."""
    return normalise(np.stack([-slope_x, np.ones_like(slope_x), -slope_z], axis=-1))


def water_surface(waves: np.ndarray, x: np.ndarray, z: np.ndarray, level: float = 0.0) -> Mesh:
    """The mesh y = level + h(x, z), with the analytic normals of the waves, upwards.

    Parameters
    ----------
    x, z: ascending and descending coordinates, (X,) and (Z,).
    """
    height, *slopes = sum_waves(waves, x, z)
    points = np.stack(np.broadcast_arrays(x[None, :], level + height, z[:, None]), axis=-1)
    return replace(grid(points), normals=upward_normals(*slopes).reshape(-1, 3))

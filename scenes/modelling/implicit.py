"""Closed smooth meshes from functions that are negative inside a solid (surface nets).

:func:`union` joins solids and :func:`intersection` cuts them; intersecting with the negative of a
solid removes it. Both round the new edges. Where the functions are roughly distances, ``fillet`` is
roughly the size of the rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from gpf.core.vectors import normalise
from gpf.modelling.meshes import Mesh

Field = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def union(a: np.ndarray, b: np.ndarray, fillet: float) -> np.ndarray:
    """The union of two solids, with a fillet of this size where they meet.

    A polynomial smooth minimum: ``min(a, b) - max(f - |a - b|, 0)² / (4 f)``.
    """
    return np.minimum(a, b) - np.maximum(fillet - np.abs(a - b), 0) ** 2 / (4 * fillet)


def intersection(a: np.ndarray, b: np.ndarray, fillet: float) -> np.ndarray:
    """The intersection of two solids, with edges rounded by ``fillet``."""
    return -union(-a, -b, fillet)


def gradient(field: Field, points: np.ndarray, step: float) -> np.ndarray:
    """Central differences of ``field`` at points (N, 3)."""
    columns = []
    for axis in range(3):
        offset = step * np.eye(3)[axis]
        columns.append(field(*(points + offset).T) - field(*(points - offset).T))
    return np.stack(columns, axis=1) / (2 * step)


def spaced(start: float, *parts: tuple[float, float]) -> np.ndarray:
    """Grid planes along an axis from ``start``; each part (end, distance) has its own spacing."""
    planes = [start]
    for end, distance in parts:
        planes += list(np.arange(planes[-1] + distance, end, distance))
    return np.array(planes)


def polygonize(field: Field, axes: Sequence[np.ndarray]) -> Mesh:
    """The surface field = 0 inside a grid, as a closed mesh with normals along the gradient.

    Every cell with corners of both signs gets a point. Every grid edge with ends of both signs gets
    a quad over the four cells around it, counter-clockwise from outside. Then the points are spread
    evenly and moved onto the surface by Newton steps along the gradient.

    Parameters
    ----------
    field: ``field(x, y, z)`` broadcasts its arguments, so parts that depend on two coordinates are
        computed only on a plane of the grid.
    axes: the planes of the grid, which contains the whole surface with a margin of two cells. Parts
        thinner than 1.5 cells may tear.
    """
    cell = min(float(np.diff(axis).min()) for axis in axes)
    value = field(axes[0][:, None, None], axes[1][None, :, None], axes[2][None, None, :])
    shape = np.array(value.shape)
    total, count = np.zeros((value.size, 3)), np.zeros(value.size)
    quads = []
    for axis in range(3):
        one = np.eye(3, dtype=int)[axis]
        near = value[tuple(slice(0, n - d) for n, d in zip(shape, one, strict=True))]
        far = value[tuple(slice(d, None) for d in one)]
        place = np.argwhere((near < 0) != (far < 0))
        a, b = near[tuple(place.T)], far[tuple(place.T)]
        crossing = place + (a / (a - b))[:, None] * one
        # Counter-clockwise around the edge as seen from its far end, which is outside where a < 0.
        right, up = np.eye(3, dtype=int)[(axis + 1) % 3], np.eye(3, dtype=int)[(axis + 2) % 3]
        around = [place - right - up, place - up, place, place - right]
        corners = np.stack([np.ravel_multi_index(tuple(c.T), value.shape) for c in around], axis=1)
        for column in corners.T:
            for k in range(3):
                total[:, k] += np.bincount(column, crossing[:, k], value.size)
            count += np.bincount(column, minlength=value.size)
        quads.append(np.where((a < 0)[:, None], corners, corners[:, ::-1]))
    used = np.flatnonzero(count)
    index = np.zeros(value.size, dtype=int)
    index[used] = np.arange(len(used))
    q = index[np.concatenate(quads)]
    middle = total[used] / count[used, None]  # in cells, as fractions
    points = np.stack(
        [np.interp(middle[:, i], np.arange(len(p)), p) for i, p in enumerate(axes)], axis=1
    )
    step = 1e-3 * cell
    for i in range(7):
        if i < 3:  # spread the points evenly
            points = (points + _neighbours_mean(points, q)) / 2
        slope = gradient(field, points, step)
        move = (field(*points.T) / np.maximum((slope**2).sum(axis=1), 1e-6))[:, None] * slope
        points -= np.clip(move, -cell / 4, cell / 4)
    normals = normalise(gradient(field, points, step))
    # Cut quads along the shorter diagonal, which preserves ridges.
    ac = np.linalg.norm(points[q[:, 0]] - points[q[:, 2]], axis=1)
    bd = np.linalg.norm(points[q[:, 1]] - points[q[:, 3]], axis=1)
    q = np.where((ac <= bd)[:, None], q, np.roll(q, -1, axis=1))
    return Mesh(points, np.concatenate([q[:, [0, 1, 2]], q[:, [0, 2, 3]]]), normals)


def _neighbours_mean(points: np.ndarray, quads: np.ndarray) -> np.ndarray:
    """For each point, the mean of the points that share an edge of a quad with it."""
    here, there = quads.ravel(), np.roll(quads, -1, axis=1).ravel()  # each edge once per direction
    columns = [np.bincount(here, points[there, k], len(points)) for k in range(3)]
    return np.stack(columns, axis=1) / np.bincount(here, minlength=len(points))[:, None]

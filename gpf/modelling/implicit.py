"""Closed smooth meshes from functions that are negative inside a solid (surface nets).

Solids are joined by :func:`union`, cut by :func:`intersection`, hollowed by intersecting with the
negative of another; all of them round the seam they make. Wherever the function is roughly a
distance, the roundings have the lengths asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from gpf.modelling.meshes import Mesh

Field = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def union(a: np.ndarray, b: np.ndarray, fillet: float) -> np.ndarray:
    """Both solids, with a fillet of this size where they meet: a polynomial smooth minimum."""
    return np.minimum(a, b) - np.maximum(fillet - np.abs(a - b), 0) ** 2 / (4 * fillet)


def intersection(a: np.ndarray, b: np.ndarray, fillet: float) -> np.ndarray:
    """What two solids have in common, its edges rounded by ``fillet``."""
    return -union(-a, -b, fillet)


def gradient(field: Field, points: np.ndarray, step: float) -> np.ndarray:
    """Central differences of ``field`` at points (N, 3)."""
    columns = []
    for axis in range(3):
        offset = step * np.eye(3)[axis]
        columns.append(field(*(points + offset).T) - field(*(points - offset).T))
    return np.stack(columns, axis=1) / (2 * step)


def spaced(start: float, *parts: tuple[float, float]) -> np.ndarray:
    """Grid planes along an axis: from ``start`` on, each part (end, distance) with its own."""
    planes = [start]
    for end, distance in parts:
        planes += list(np.arange(planes[-1] + distance, end, distance))
    return np.array(planes)


def polygonize(field: Field, axes: Sequence[np.ndarray]) -> Mesh:
    """The surface field = 0 inside a grid, as a mesh with normals along the gradient.

    ``field(x, y, z)`` broadcasts its arguments; parts of it that depend on two of them alone are
    therefore computed on a plane of the grid alone. ``axes`` are the grid's planes; it contains the
    whole surface with two cells to spare. Parts thinner than a cell and a half may tear.

    Every cell whose corners differ in sign gets a point, every grid edge between two signs gets a
    quad over the four cells around it: closed, and counter-clockwise from outside. Then the points
    are spread evenly, and taken onto the surface by Newton steps along the gradient.
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
        # Around the edge, seen from its far end: right-handed, hence outwards where a < 0.
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
        if i < 3:  # even out the quads
            points = (points + _neighbours_mean(points, q)) / 2
        slope = gradient(field, points, step)
        move = (field(*points.T) / np.maximum((slope**2).sum(axis=1), 1e-6))[:, None] * slope
        points -= np.clip(move, -cell / 4, cell / 4)
    normals = gradient(field, points, step)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    # Along the shorter diagonal, so that ridges stay ridges.
    ac = np.linalg.norm(points[q[:, 0]] - points[q[:, 2]], axis=1)
    bd = np.linalg.norm(points[q[:, 1]] - points[q[:, 3]], axis=1)
    q = np.where((ac <= bd)[:, None], q, np.roll(q, -1, axis=1))
    return Mesh(points, np.concatenate([q[:, [0, 1, 2]], q[:, [0, 2, 3]]]), normals)


def _neighbours_mean(points: np.ndarray, quads: np.ndarray) -> np.ndarray:
    """At each point the mean of those that an edge of a quad joins it with."""
    here, there = quads.ravel(), np.roll(quads, -1, axis=1).ravel()  # each edge once per direction
    columns = [np.bincount(here, points[there, k], len(points)) for k in range(3)]
    return np.stack(columns, axis=1) / np.bincount(here, minlength=len(points))[:, None]

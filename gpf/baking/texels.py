"""The texels of a page that bilinear lookups on its triangles read, and where their light is taken.

A lookup reads the four texels whose centres are less than one texel away in each direction. So the
texels of a triangle are all whose centres are within sqrt(2) of it: those outside, beyond a chart's
border, take the light of the nearest point inside.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt

# Largest distance of a texel's centre from its triangle, texels.
REACH = 2**0.5

# Points that are nearer than this to the edge of their triangle move inwards as far, texels: at the
# foot of a wall, rays towards lamps would otherwise start inside the wall.
INSET = 0.1

# Pairs of a triangle and a texel that are compared at once.
AT_ONCE = 1 << 19

# How far light spreads to texels about which nothing is known, texels.
SPREAD = 2.0


@dataclass(frozen=True)
class Texels:
    """Texels with a place on a surface.

    Attributes
    ----------
    index: row times width plus column, ascending, (P,).
    triangle: the nearest triangle, (P,).
    weights: barycentric coordinates of a point of that triangle, (P, 3).
    """

    index: np.ndarray
    triangle: np.ndarray
    weights: np.ndarray


def find_texels(triangles: np.ndarray, size: tuple[int, int]) -> Texels:
    """The texels of triangles whose corners are given in texels, (T, 3, 2)."""
    count = size[0] * size[1]
    nearest, owner = np.full(count, np.inf, np.float32), np.zeros(count, np.int64)
    weights = np.zeros((count, 3), np.float32)
    for triangle, texel in _pairs(triangles, size):
        centre = np.stack([texel % size[0], texel // size[0]], axis=1) + 0.5
        found, distance = nearest_points(triangles[triangle], centre)
        close = np.flatnonzero(distance <= REACH)
        close = close[np.lexsort((distance[close], texel[close]))]
        close = close[np.unique(texel[close], return_index=True)[1]]
        close = close[distance[close] < nearest[texel[close]]]
        place = texel[close]
        nearest[place], owner[place] = distance[close], triangle[close]
        weights[place] = found[close]
    index = np.flatnonzero(nearest < np.inf)
    corners = triangles[owner[index]]
    return Texels(index, owner[index], _keep_inside(weights[index], corners))


def _pairs(triangles: np.ndarray, size: tuple[int, int]) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Triangles, and texels in the boxes around them, some at a time, (K,) each."""
    low = np.clip(np.floor(triangles.min(axis=1) - REACH - 0.5), 0, np.array(size) - 1)
    high = np.clip(np.ceil(triangles.max(axis=1) + REACH - 0.5), 0, np.array(size) - 1)
    low, extent = low.astype(np.int64), (high - low).astype(np.int64) + 1
    real = np.abs(_doubled_areas(triangles)) > 1e-9
    after = np.cumsum(np.where(real, extent.prod(axis=1), 0))
    for first in range(0, int(after[-1]), AT_ONCE):
        pair = np.arange(first, min(first + AT_ONCE, int(after[-1])))
        triangle = np.searchsorted(after, pair, side="right")
        inside = pair - np.where(triangle > 0, after[triangle - 1], 0)
        width = extent[triangle, 0]
        x, y = low[triangle, 0] + inside % width, low[triangle, 1] + inside // width
        yield triangle, y * size[0] + x


def nearest_points(corners: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The points of triangles that are nearest to points of the plane: their barycentric
    coordinates, (K, 3), and distances, (K,).

    Parameters
    ----------
    corners: (K, 3, 2), not on one line.
    q: (K, 2).
    """
    towards = q[:, None] - corners
    following = np.roll(corners, -1, axis=1) - corners
    # The doubled area beyond each edge belongs to the corner opposite.
    beyond = following[..., 0] * towards[..., 1] - following[..., 1] * towards[..., 0]
    weights = np.roll(beyond / _doubled_areas(corners)[:, None], 2, axis=1)
    along = (towards * following).sum(axis=2) / np.maximum((following**2).sum(axis=2), 1e-30)
    along = np.clip(along, 0, 1)
    distances = np.linalg.norm(towards - along[..., None] * following, axis=2)
    edge = distances.argmin(axis=1)
    lane = np.arange(len(q))
    on_edge = np.zeros_like(weights)
    on_edge[lane, edge] = 1 - along[lane, edge]
    on_edge[lane, (edge + 1) % 3] = along[lane, edge]
    outside = (weights < 0).any(axis=1)
    distance = np.where(outside, distances[lane, edge], 0)
    return np.where(outside[:, None], on_edge, weights), distance


def _keep_inside(weights: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Barycentric coordinates, with points near an edge moved by at most :data:`INSET` towards the
    middle of their triangle."""
    sides = np.linalg.norm(np.roll(corners, 1, axis=1) - np.roll(corners, -1, axis=1), axis=2)
    heights = np.abs(_doubled_areas(corners))[:, None] / np.maximum(sides, 1e-30)
    near = (weights * heights).min(axis=1) < INSET
    inwards = 1 / 3 - weights
    away = np.linalg.norm(np.einsum("pk,pki->pi", inwards, corners), axis=1)
    step = np.where(near, np.minimum(INSET / np.maximum(away, 1e-30), 1), 0)
    return np.asarray(weights + step[:, None] * inwards)


def _doubled_areas(corners: np.ndarray) -> np.ndarray:
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def fill_page(
    values: np.ndarray, known: np.ndarray, texels: Texels, size: tuple[int, int]
) -> np.ndarray:
    """A page of the light at texels, (H, W, C) float32, without gaps.

    Texels of no triangle take the light of the nearest one. So do those about which nothing is
    known, such as the floor inside a box that stands on it, but only from at most :data:`SPREAD`
    texels away: beyond that they are black.

    Parameters
    ----------
    values, known: light at the texels, (P, C), and whether it is known, (P,).
    """
    width, height = size
    page = np.zeros((height * width, values.shape[1]), np.float32)
    page[texels.index] = np.where(known[:, None], values, 0)
    covered, certain = (np.zeros(height * width, bool) for _ in range(2))
    covered[texels.index], certain[texels.index] = True, known
    if known.any() and not known.all():
        distance, nearest = _nearest(certain.reshape(height, width))
        unknown = covered & ~certain & (distance <= SPREAD)
        page[unknown] = page[nearest[unknown]]
    _, nearest = _nearest(covered.reshape(height, width))
    return page[nearest].reshape(height, width, -1)


def _nearest(mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The distance of each texel from the nearest one in a mask, and that one's index."""
    distance, (row, column) = distance_transform_edt(~mask, return_indices=True)
    return distance.ravel(), (row * mask.shape[1] + column).ravel()

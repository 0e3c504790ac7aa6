"""How fine a field should be at each place, from two independent halves of the photons.

At each level, the light is smoothed as a field of that level would smooth it: a linear function is
fitted to the targets in each cell of a grid. With f_a and f_b fitted to targets a and b of two
independent halves, the squared error of the mean of both fits is, up to the noise of the targets,

    mean((f_a - b)² + (f_b - a)²) / 2 - mean((f_a - f_b)²) / 4.

Each point is judged by functions that are fitted without it: otherwise, where points are few, the
finest cells would hold one each, and be right everywhere but between the points. The error is
summed over each cell of the field's grid and the cells around it, and the level with the least
error is chosen: once with closer sums and once with wider ones. The coarser choice counts.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import mitsuba as mi
import numpy as np

from gpf.core.machine import count_cores
from gpf.core.structs import SurfacePoints, to_numpy
from gpf.field.by_detail import field_by_detail
from gpf.field.detail import Detail
from gpf.field.field import GaussianPhotonField
from gpf.field.initialization import DISTANCE
from gpf.field.settings import FieldSettings
from gpf.guiding.density_control import cell_keys
from gpf.scene.bounds import scene_bounds
from gpf.training.loss import relative_weight

LEVELS = 7

# Search radius of the finest level, in radii of the targets' narrowest kernel: the distance between
# its Gaussians is two thirds of the kernel's radius.
FINEST = 1.5

# Each of the two finest levels has to reduce the error of the level before it by this share.
LEAST_GAIN = 0.2

WORTH_CHANGING = 0.25
"""Share of the error by which another level has to be better than that of the frame before."""

# Edge of the cells of the field's grid, in search radii of level 3. Smaller cells would be decided
# by too few points.
CELL = 1.0
MOST_CELLS = 1 << 19
"""Most cells of a field's grid."""

CLOSE, WIDE = 0.8, 1.3
"""Standard deviations of the Gaussians that sum the errors over neighbouring cells, in cells. With
closer sums alone, single cells on plain walls are too fine by chance, which shows as blots."""

# Edge of a cell in which a linear function is fitted, in distances between Gaussians. At the square
# root of three, the fit would have as many numbers per area as there are Gaussians, but a Gaussian
# adapts its shape and position as well as its colour. Of 1.7, 1.2, 0.85 and 0.6, the last two gave
# the best images of four scenes.
_FIT = 0.7

# Keeps slopes small in cells with few points.
_RIDGE = 0.5

# Lower limit of 1 - h: the share of a point's value that the others in its cell decide.
_LEAST_FREE = 0.1


def field_by_place(
    points: SurfacePoints,
    halves: tuple[SurfacePoints, SurfacePoints],
    kernel: float,
    scene: mi.Scene,
    query: Callable[[float], FieldSettings],
    seed: int,
    fill_gaps: bool = True,
) -> GaussianPhotonField:
    """The field before training, with as many Gaussians at each place as its light needs.

    Parameters
    ----------
    points: the field will be trained on these.
    halves: the same points, with targets from two independent halves of the photons.
    kernel: radius of the targets' narrowest kernel, world units.
    query: the settings of the field, given its search radius.
    fill_gaps: whether places with too few Gaussians around them get more.
    """
    bounds = scene_bounds(scene)
    detail = choose_detail(points, halves, kernel, bounds)
    at = to_numpy(points.p), to_numpy(points.n)
    return field_by_detail(scene, detail, query(detail.radius), bounds, at, seed, fill_gaps)


def choose_detail(
    points: SurfacePoints,
    halves: tuple[SurfacePoints, SurfacePoints],
    kernel: float,
    bounds: tuple[Any, Any],
    earlier: Detail | None = None,
) -> Detail:
    """Choose the levels of a field.

    Parameters
    ----------
    points: supervised points, with targets from all photons, (P).
    halves: the same points, with targets from two independent halves of the photons.
    kernel: radius of the targets' narrowest kernel, world units.
    bounds: corners of the scene's bounding box.
    earlier: the levels of the frame before, on the same grid. They change only where that reduces
        the error by :data:`WORTH_CHANGING`: Gaussians at a place that keeps its level can stay.
    """
    position, normal = to_numpy(points.p), to_numpy(points.n)
    from scipy.ndimage import gaussian_filter  # slow to import

    grid = _lay_grid(kernel, bounds) if earlier is None else earlier
    shape, corner, width, radius = grid.table.shape, grid.corner, grid.width, grid.radius
    cells = np.clip(np.floor((position - corner) / width).astype(np.int64), 0, np.array(shape) - 1)
    cell = np.ravel_multi_index(cells.T, shape)
    a, b = (to_numpy(half.target) for half in halves)
    both = np.concatenate([a, b], axis=1)
    weight = _weigh_cells(cell, both.mean(axis=1))[cell]
    widths = [_FIT * DISTANCE * radius / 2**level for level in range(LEVELS)]
    totals, before = [], np.broadcast_to(both.mean(axis=0), both.shape)
    with ThreadPoolExecutor(count_cores()) as pool:  # each numpy call uses one core
        fits = pool.map(lambda width: fit_linear(position, normal, both, width), widths)
    for fit, alone in fits:
        fit[alone] = before[alone]
        before, fit_a, fit_b = fit, fit[:, :3], fit[:, 3:]
        error = ((fit_a - b) ** 2 + (fit_b - a) ** 2) / 2 - (fit_a - fit_b) ** 2 / 4
        total = np.bincount(cell, weight * error.sum(axis=1), math.prod(shape))
        totals.append(total.reshape(shape))

    def choose(smoothing: float) -> tuple[np.ndarray, np.ndarray]:
        """The error of each level, and the level with the least."""
        errors = gaussian_filter(totals, (0, *[smoothing] * 3), mode="constant")
        # The finest levels are for targets of narrow kernels; elsewhere they gain nothing.
        for level in (-2, -1):
            errors[level] += LEAST_GAIN * np.abs(errors[level - 1])
        return errors, np.argmin(errors, axis=0).astype(np.uint8)

    errors, table = choose(CLOSE)
    table = np.minimum(table, choose(WIDE)[1])
    if earlier is not None:
        was, least = (
            np.take_along_axis(errors, levels[None].astype(int), 0)[0]
            for levels in (earlier.table, table)
        )
        table = np.where(was - least > WORTH_CHANGING * np.abs(was), table, earlier.table)
    return Detail(table, width, corner, radius)


def _lay_grid(kernel: float, bounds: tuple[Any, Any]) -> Detail:
    """The grid of a field, all at level 0."""
    radius = FINEST * kernel * 2 ** (LEVELS - 1)
    corner = np.array([float(bounds[0][i]) for i in range(3)])
    extent = np.array([float(bounds[1][i]) for i in range(3)]) - corner
    width = CELL * radius / 8
    while np.prod(np.floor(extent / width) + 1) > MOST_CELLS:
        width *= 1.1
    shape = tuple(int(n) for n in np.floor(extent / width) + 1)
    return Detail(np.zeros(shape, np.uint8), width, corner, radius)


def _weigh_cells(cell: np.ndarray, light: np.ndarray) -> np.ndarray:
    """The weight of an error in each cell, (C,): as in the loss, but the same at all points of the
    cell, because single targets are noisy.

    Parameters
    ----------
    cell: number of each point's cell, (P,).
    light: light at each point, (P,).
    """
    unit = max(float(light.mean()), 1e-20)
    mean = np.bincount(cell, light) / np.maximum(np.bincount(cell), 1)
    return np.asarray(relative_weight(mean / unit))


def fit_linear(
    position: np.ndarray,
    normal: np.ndarray,
    values: np.ndarray,
    width: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Fit linear functions of the position to values, (P, K), in each cell of a grid.

    Returns the functions at the points, (P, K), and which points are alone in their cells, (P,)
    bool. Each point gets the function that is fitted to the others in its cell: with the leverage h
    of a point, f + h / (1 - h) (f - v). Surfaces with different orientations have different cells.

    Parameters
    ----------
    width: edge length of a cell, world units.
    """
    key = cell_keys(position, normal, width)
    order = np.argsort(key, kind="stable")
    ordered = key[order]
    starts = np.flatnonzero(np.r_[True, ordered[1:] != ordered[:-1]])
    count = np.diff(np.r_[starts, len(key)])
    index = np.repeat(np.arange(len(starts)), count)

    def mean(rows: np.ndarray) -> np.ndarray:
        """Mean over each cell, from rows sorted by cell."""
        return np.add.reduceat(rows, starts, axis=0) / count[:, None].astype(rows.dtype)

    # Offsets in units of the cell: single precision is enough from here on.
    place = position[order] / width
    offset = (place - mean(place)[index]).astype(np.float32)
    value = values[order].astype(np.float32)
    level = mean(value)
    rest = value - level[index]
    products = mean(offset[:, [0, 0, 0, 1, 1, 2]] * offset[:, [0, 1, 2, 1, 2, 2]])
    ridge = (_RIDGE / count)[:, None, None] * np.eye(3)
    left = products[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3) + ridge
    right = np.stack([mean(offset[:, [i]] * rest) for i in range(3)], axis=1)
    inverse = np.linalg.inv(left).astype(np.float32)
    slopes = (inverse @ right)[index]
    # The residual f - v, which grows if the fit leaves out the point.
    fitted = -rest
    for i in range(3):
        fitted += offset[:, [i]] * slopes[:, i]
    leverage = 1 + np.einsum("pi,pij,pj->p", offset, inverse[index], offset)
    leverage /= count[index]
    fitted *= (1 / np.maximum(1 - leverage, _LEAST_FREE))[:, None].astype(np.float32)
    fitted += value
    result, alone = np.empty_like(fitted), np.empty(len(order), bool)
    result[order], alone[order] = fitted, count[index] == 1
    return result, alone

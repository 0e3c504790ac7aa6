"""The Gaussians of a field with levels, before training: as many at each place as its level asks
for, and some wherever a point would have none near it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.structs import concatenate, from_numpy, take, to_numpy
from gpf.core.vectors import normalise
from gpf.field.detail import Detail
from gpf.field.field import GaussianPhotonField
from gpf.field.gaussians import Gaussians
from gpf.field.initialization import DISTANCE, TYPICAL_SCALE, find_gaps
from gpf.field.limits import find_limits, no_limits
from gpf.field.settings import FieldSettings
from gpf.guiding.density_control import cell_keys

# Distances between the Gaussians that fill gaps, in search radii, tried in this order: the more
# curved a surface is, the closer they must be for one that faces the same way to be near.
GAP_DISTANCES = DISTANCE / 2, DISTANCE / 4, DISTANCE / 8

DENSEST = 0.3
"""Training gathers Gaussians along lines of light, and new ones fill the gaps. So that their number
does not grow with the frames, at most one stays in each cell of a grid with this edge, in distances
between Gaussians; surfaces that face different directions have separate cells."""

SMOOTH_LEVELS, SHAPE_KEPT = 2, 0.5
"""At so many of the coarsest levels, only this share of the difference between the scales of a
Gaussian and the usual ones stays. In smooth light a shape learns little but the noise of the
photons, which is the same in all frames, and after many frames smudges would show. Where light is
sharp, shapes are worth keeping."""

# Up to this, 1 plus the cosine between two directions makes them opposite.
_OPPOSITE = 1e-3


@dataclass(frozen=True)
class Moves:
    """How Gaussians move with their surfaces from one frame to the next.

    Attributes
    ----------
    shift: world units, (N, 3).
    normals: of their surfaces in the next frame, (N, 3).
    known: whether the next frame has such a surface, (N,) bool.
    """

    shift: np.ndarray
    normals: np.ndarray
    known: np.ndarray


def field_by_detail(
    scene: mi.Scene,
    detail: Detail,
    settings: FieldSettings,
    bounds: tuple[mi.ScalarPoint3f, mi.ScalarPoint3f],
    points: tuple[np.ndarray, np.ndarray],
    seed: int,
    fill_gaps: bool = True,
) -> GaussianPhotonField:
    """An untrained field with levels, with Gaussians at some of the points where it is needed.

    One Gaussian per cell of a grid (:func:`place_by_detail`) is too few for anything smaller than
    the cell: it may be on another side, or on another object. So points with too few around them
    get more, at smaller and smaller distances (:data:`GAP_DISTANCES`).

    Parameters
    ----------
    bounds: corners of the scene's bounding box.
    points: positions, world units, and unit normals, (P, 3) each.
    fill_gaps: whether cells may get more than one Gaussian.
    """
    gaussians = place_by_detail(detail, *points, seed)
    limits = find_limits(scene, gaussians, detail)
    field = GaussianPhotonField(gaussians, settings, bounds, detail=detail, limits=limits)
    _fill_gaps(scene, field, points, seed, GAP_DISTANCES if fill_gaps else ())
    return field


def field_of_frame(
    scene: mi.Scene,
    field: GaussianPhotonField,
    detail: Detail,
    settings: FieldSettings,
    bounds: tuple[mi.ScalarPoint3f, mi.ScalarPoint3f],
    points: tuple[np.ndarray, np.ndarray],
    moves: Moves,
    seed: int,
) -> GaussianPhotonField:
    """The field of the frame before as the start of the next frame's.

    Gaussians move and turn with their surfaces, by the least turn: light does not spin with a ball
    that spins. They stay if queries of their level may still reach them, and if they are not much
    too close together (:data:`DENSEST`); wherever too few are left, there are new ones. Where light
    is smooth, they become rounder (:data:`SMOOTH_LEVELS`).

    Parameters
    ----------
    detail: the levels of the next frame, on the grid of the field's or a larger one
        (:meth:`Detail.around`).
    settings: of the next frame's field.
    bounds, points: as for :func:`field_by_detail`.
    moves: of the field's Gaussians.
    """
    assert field.detail is not None
    means = to_numpy(field.gaussians.means)
    level = field.detail.levels_of(means)
    there = field.detail.fold(means) + moves.shift
    rows, apart = _near(detail, level, there, moves)
    if len(rows) == 0:
        return field_by_detail(scene, detail, settings, bounds, points, seed)
    gaussians = take(field.gaussians, from_numpy(mi.UInt32, rows))
    means, level, shift = means[rows], level[rows], moves.shift[rows]
    # The same grid adds exactly 0, so that places that do not move keep their bits.
    means = means + (shift + (field.detail.corner - detail.corner)) * 2.0 ** level[:, None]
    means[:, 0] += detail.starts[level] - field.detail.starts[level]
    gaussians.means = from_numpy(mi.Point3f, means)
    turn = _turn(to_numpy(gaussians.normals), moves.normals[rows])
    gaussians.quats = from_numpy(mi.Quaternion4f, turn) * gaussians.quats
    gaussians.normals = from_numpy(mi.Normal3f, moves.normals[rows])
    usual, smooth = _usual_scale(detail), from_numpy(mi.UInt32, level) < SMOOTH_LEVELS
    rounder = usual + SHAPE_KEPT * (gaussians.log_scales - usual)
    gaussians.log_scales = dr.select(smooth, rounder, gaussians.log_scales)
    gaussians = _thin_out(gaussians, apart, detail, settings, bounds)
    limits = find_limits(scene, gaussians, detail)
    found = GaussianPhotonField(gaussians, settings, bounds, detail=detail, limits=limits)
    _fill_gaps(scene, found, points, seed, (DISTANCE, *GAP_DISTANCES))
    return found


def _near(
    detail: Detail, level: np.ndarray, there: np.ndarray, moves: Moves
) -> tuple[np.ndarray, np.ndarray]:
    """The numbers of the Gaussians that queries of their level may reach, (M,) in order, and which
    of them are apart from older ones (:data:`DENSEST`), (M,) bool. Those that are closer together
    than any that fill a gap are left out.

    Parameters
    ----------
    level, there: their levels, (N,), and new places, world units, (N, 3).
    """
    near, apart = np.zeros((2, len(level)), bool)
    for number in np.unique(level).tolist():
        own = np.flatnonzero(moves.known & (level == number))
        own = own[detail.reaches(there[own], number)]
        for distance, found in ((GAP_DISTANCES[-1], near), (DENSEST * DISTANCE, apart)):
            width = distance * detail.radius / 2**number
            found[own[_firsts(there[own], moves.normals[own], width)]] = True
    rows = np.flatnonzero(near | apart)
    return rows, apart[rows]


def _firsts(position: np.ndarray, normal: np.ndarray, width: float) -> np.ndarray:
    """The number of the first point in each cell with points (P, 3)."""
    if len(position) == 0:
        return np.zeros(0, np.int64)
    return np.unique(cell_keys(position, normal, width), return_index=True)[1]


def _thin_out(
    gaussians: Gaussians,
    apart: np.ndarray,
    detail: Detail,
    settings: FieldSettings,
    bounds: tuple[mi.ScalarPoint3f, mi.ScalarPoint3f],
) -> Gaussians:
    """Those that are ``apart``, (N,) bool, and where these are too few, the others as well: on
    small curved things, Gaussians have to be close together."""
    if apart.all():
        return gaussians
    kept = take(gaussians, from_numpy(mi.UInt32, np.flatnonzero(apart)))
    field = GaussianPhotonField(kept, settings, bounds, detail=detail)
    p = from_numpy(mi.Point3f, detail.fold(to_numpy(gaussians.means)))
    _, reach = field.query(p, gaussians.normals, from_numpy(mi.Bool, ~apart))
    rows = np.flatnonzero(apart | (reach.numpy() > 1))
    return take(gaussians, from_numpy(mi.UInt32, rows))


def _turn(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """The least rotations of unit vectors onto others, (N, 3), as quaternions, (N, 4); none for
    opposite ones."""
    real = 1 + (start * end).sum(axis=1, keepdims=True)
    turn = np.concatenate([np.cross(start, end), real], axis=1)
    turn[real[:, 0] < _OPPOSITE] = 0, 0, 0, 1
    return normalise(turn)


def _fill_gaps(
    scene: mi.Scene,
    field: GaussianPhotonField,
    points: tuple[np.ndarray, np.ndarray],
    seed: int,
    distances: Sequence[float],
) -> None:
    """Add Gaussians at points with too few around them."""
    assert field.detail is not None
    detail = field.detail
    for number, distance in enumerate(distances):
        gaps = find_gaps(field, *points, seed + number, distance, most=1)
        if dr.width(gaps.p) == 0:
            break
        more = _untrained(to_numpy(field.unfold(gaps.p)), to_numpy(gaps.n), detail, seed + number)
        more_limits = find_limits(scene, more, detail)
        if field.limits is not None or more_limits is not None:
            parts = (field.gaussians, field.limits), (more, more_limits)
            field.limits = np.concatenate(
                [no_limits(dr.width(g.means)) if found is None else found for g, found in parts]
            )
        field.update(concatenate([field.gaussians, more]))


def place_by_detail(
    detail: Detail,
    position: np.ndarray,
    normal: np.ndarray,
    seed: int,
    distance: float = DISTANCE,
) -> Gaussians:
    """Gaussians at some of the points where a field is needed, as many as its levels ask for.

    At each level, a grid has cells of ``distance`` radii; each cell with points that queries of the
    level may reach gets a Gaussian at one of them, of irradiance 0.

    Parameters
    ----------
    position, normal: world units and unit vectors, (P, 3).
    """
    rng = np.random.default_rng(seed)
    means, normals = [], []
    for level in range(detail.count):
        near = np.flatnonzero(detail.reaches(position, level))
        if len(near) == 0:
            continue
        rng.shuffle(near)
        width = distance * detail.radius / 2**level
        _, first = np.unique(cell_keys(position[near], normal[near], width), return_index=True)
        chosen = near[np.sort(first)]
        means.append(detail.unfold_all(position[chosen], level))
        normals.append(normal[chosen])
    return _untrained(np.concatenate(means), np.concatenate(normals), detail, seed)


def _usual_scale(detail: Detail) -> float:
    """The log scale of a Gaussian before training, in the unfolded space."""
    return math.log(TYPICAL_SCALE * detail.radius)


def _untrained(p: np.ndarray, n: np.ndarray, detail: Detail, seed: int) -> Gaussians:
    """Gaussians at positions in the unfolded space, with normals, (N, 3) each."""
    count = len(p)
    quats = np.random.default_rng(seed).normal(size=(4, count)).T
    gaussians = Gaussians(
        means=from_numpy(mi.Point3f, p),
        log_scales=dr.full(mi.Vector3f, _usual_scale(detail), count),
        quats=from_numpy(mi.Quaternion4f, quats),
        irradiance=dr.zeros(mi.Color3f, count),
        normals=from_numpy(mi.Normal3f, n),
    )
    dr.eval(gaussians)
    return gaussians

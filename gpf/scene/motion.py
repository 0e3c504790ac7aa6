"""Where the points of a scene's surfaces are in another frame of an animation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import zip_longest
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.structs import from_numpy
from gpf.scene.bounds import scene_bounds
from gpf.scene.shapes import all_shapes

NEAR = 1e-4
"""How far from its surface a point may always lie, relative to the size of the scene."""


class Motion:
    """How the surfaces of a scene move to another frame of the same animation.

    Shapes correspond by their ids or, if some have none, by their order. On meshes, a point keeps
    its triangle and its place in it; on other shapes it follows their ``to_world``.

    Parameters
    ----------
    start, end: the frames.

    Attributes
    ----------
    lost: names of shapes of ``start`` that have no counterpart: the other frame has no shape with
        this id (without ids: another number of shapes), another kind of shape, or a mesh with other
        triangles.
    still: whether no shape moves, and none is lost.
    """

    def __init__(self, start: mi.Scene, end: mi.Scene) -> None:
        self._start, self._end = start, end
        shapes, others = start.shapes(), end.shapes()
        places = _counterparts(shapes, others)
        found = [None if place is None else others[place] for place in places]
        moves = [_move(*pair) for pair in zip(shapes, found, strict=True)]
        self.lost = [_name(s) for s, move in zip(shapes, moves, strict=True) if move is None]
        self.still = all(_is_still(move) for move in (*moves, *_inner_moves(start, end)))
        bent = [move is _BENT for move in moves]
        matrices = [move if isinstance(move, np.ndarray) else _STILL for move in moves]
        self._others = from_numpy(mi.UInt32, np.array([p or 0 for p in places], np.uint32))
        self._known = mi.Bool([move is not None for move in moves])
        self._bent, self._moves = mi.Bool(bent), from_numpy(mi.Float, np.array(matrices).ravel())
        corners = (np.array(corner, dtype=float) for corner in scene_bounds(start))
        self._near = NEAR * float(np.linalg.norm(np.subtract(*corners)))

    def carry(
        self, p: mi.Point3f, n: mi.Normal3f, reach: mi.Float
    ) -> tuple[mi.Point3f, mi.Normal3f, mi.Bool]:
        """Points near the first frame's surfaces in the other frame.

        Parameters
        ----------
        p, n: positions and normals, (N, 3).
        reach: how far above or below its surface a point may lie, world units, (N,). Those without
            a surface stay.

        Returns
        -------
        p, n: positions and normals, (N, 3).
        known: whether they are: not on what is lost or instanced, (N,).
        """
        if self.still:
            return p, n, dr.full(mi.Bool, True, dr.width(p))
        reach = dr.maximum(reach, self._near)
        ray, hit = self._nearest(p, mi.Vector3f(n), reach)
        found = hit.is_valid()
        place = _places(self._start, hit.shape)
        known = found & (hit.instance == None)  # noqa: E711
        known &= dr.gather(mi.Bool, self._known, place, known)
        bent = known & dr.gather(mi.Bool, self._bent, place, known)

        rows = [dr.gather(mi.Float, self._moves, 12 * place + k, known) for k in range(12)]
        matrix = mi.Matrix4f(*rows, 0, 0, 0, 1)
        move = mi.Transform4f(matrix)
        there, facing = move @ p, mi.Vector3f(move @ mi.Normal3f(n))

        other = mi.PreliminaryIntersection3f(hit)
        place = dr.gather(mi.UInt32, self._others, place, bent)
        other.shape = dr.gather(mi.ShapePtr, self._end.shapes_dr(), place, bent)
        here, si = (
            each.compute_surface_interaction(ray, mi.RayFlags.Minimal, bent)
            for each in (hit, other)
        )
        there[bent] = p + (si.p - here.p)
        facing[bent] = mi.Vector3f(dr.mulsign(si.n, dr.dot(here.n, n)))
        facing = dr.normalize(facing)
        known &= dr.all(dr.isfinite(there)) & dr.all(dr.isfinite(facing))
        p, n = dr.select(known, there, p), mi.Normal3f(dr.select(known, facing, n))
        return p, n, known | ~found

    def _nearest(
        self, p: mi.Point3f, n: mi.Vector3f, reach: mi.Float
    ) -> tuple[mi.Ray3f, mi.PreliminaryIntersection3f]:
        """The nearest surface below or above each point, and the ray that hits it."""
        rays = [mi.Ray3f(p + self._near * way, -way) for way in (n, -n)]
        for ray in rays:
            ray.maxt = reach + self._near
        below, above = (self._start.ray_intersect_preliminary(ray, False) for ray in rays)
        upwards = above.t < below.t
        ray = mi.Ray3f(dr.select(upwards, rays[1].o, rays[0].o), dr.select(upwards, n, -n))
        return ray, dr.select(upwards, above, below)


_STILL = np.eye(4, dtype=np.float32)[:3].ravel()

_BENT = "bent"
"""The move of a mesh whose vertices move."""


def _counterparts(shapes: Sequence[mi.Shape], others: Sequence[mi.Shape]) -> list[int | None]:
    """For each shape, the place of its counterpart among the others, or None."""
    if all(shape.id() for shape in (*shapes, *others)):
        places = {shape.id(): place for place, shape in enumerate(others)}
        return [places.get(shape.id()) for shape in shapes]
    return list(range(len(shapes))) if len(shapes) == len(others) else [None] * len(shapes)


def _move(start: mi.Shape | None, end: mi.Shape | None) -> np.ndarray | str | None:
    """How a shape moves: rows of a transform, (12,), or :data:`_BENT`; None if it is another."""
    if start is None or end is None or start.class_name() != end.class_name():
        return None
    first, second = _properties(start), _properties(end)
    if "faces" in first:
        keys = "faces", "vertex_positions"
        same = [np.array_equal(np.array(first[key]), np.array(second[key])) for key in keys]
        return None if not same[0] else _STILL if same[1] else _BENT
    places = [each.pop("to_world", None) for each in (first, second)]
    if not _same_values(first, second):
        return None
    if places[0] is None:
        return _STILL
    matrices = [np.array(place.matrix, float).reshape(4, 4) for place in places]
    if np.array_equal(matrices[0], matrices[1]):
        return _STILL
    moved: np.ndarray = (matrices[1] @ np.linalg.inv(matrices[0]))[:3].ravel().astype(np.float32)
    return moved


def _is_still(move: np.ndarray | str | None) -> bool:
    return isinstance(move, np.ndarray) and bool((move == _STILL).all())


def _inner_moves(start: mi.Scene, end: mi.Scene) -> list[np.ndarray | str | None]:
    """How the shapes of shape groups move within their groups."""
    inner, others = (all_shapes(scene)[len(scene.shapes()) :] for scene in (start, end))
    return [_move(*pair) for pair in zip_longest(inner, others)] if inner else []


def _properties(shape: mi.Shape) -> dict[str, Any]:
    """The properties of a shape itself, without those of its material and its light."""
    return {key: value for key, value in mi.traverse(shape) if "." not in key}


def _same_values(first: Mapping[str, Any], second: Mapping[str, Any]) -> bool:
    return first.keys() == second.keys() and all(
        np.array_equal(np.array(first[key]), np.array(second[key])) for key in first
    )


def _name(shape: mi.Shape) -> str:
    return str(shape.id()) or str(shape.class_name())


def _places(scene: mi.Scene, shapes: mi.ShapePtr) -> mi.UInt32:
    """The places of shapes in ``scene.shapes()``, (N,)."""
    numbers = np.array(dr.reinterpret_array(mi.UInt32, scene.shapes_dr()))
    table = np.zeros(int(numbers.max(initial=0)) + 1, np.uint32)
    table[numbers] = np.arange(len(numbers))
    number = dr.reinterpret_array(mi.UInt32, shapes)
    return dr.gather(mi.UInt32, from_numpy(mi.UInt32, table), number)

"""Fingerprints of scenes: has a scene changed since a field was fitted to it?

Mitsuba may merge shapes that share a material when it loads a file, so nothing here depends on how
a surface is divided into shapes, or on their order.
"""

from __future__ import annotations

import hashlib
from collections import defaultdict
from collections.abc import Iterator, Mapping
from typing import Any

import mitsuba as mi
import numpy as np

from gpf.scene.shapes import parameters

PARTS = ("geometry", "materials", "lights")

SAME = 1e-4
"""Relative difference up to which two numbers count as equal except for rounding."""

SAME_FRAME = 1e-9
"""The same for the frames of an animation, which differ by little: by 1e-5 from one frame of a
pool's waves to the next. Their shapes are never merged, so there is no rounding to forgive."""


_NAMES = " id = ", " name = "  # of materials and of texture files


def fingerprint(scene: mi.Scene) -> dict[str, Any]:
    """The :data:`PARTS` of a scene as JSON values; cameras and integrators do not matter.

    ``geometry`` is the total surface area, its centroid, and the second moments around the origin:
    ten numbers. ``materials`` maps a digest of each material and medium to the area that it covers.
    ``lights`` is a digest of each emitter and its position. The digests cover the values
    that Mitsuba exposes and, for materials, the printed form.
    """
    moments, lights = np.zeros(10), []
    areas: dict[str, float] = defaultdict(float)
    for shape in scene.shapes():
        own = _moments(shape)
        moments += own
        if (bsdf := shape.bsdf()) is not None:
            # The printed form also shows what is not among the values, but it includes names.
            lines = str(bsdf).splitlines()
            printed = "".join(x for x in lines if not any(n in x for n in _NAMES)).encode()
            areas[_digest(*_values(bsdf, set()), printed)] += float(own[0])
        for medium in (shape.interior_medium(), shape.exterior_medium()):
            if medium is not None:
                areas[_digest(*_values(medium, set()))] += float(own[0])
        if (emitter := shape.emitter()) is not None:
            inner = set() if bsdf is None else set(mi.traverse(bsdf).hierarchy)
            lights.append(_digest(*_values(shape, inner), *_values(emitter, set())))
    on_shapes = {shape.emitter() for shape in scene.shapes()}
    free = [emitter for emitter in scene.emitters() if emitter not in on_shapes]
    lights += [_digest(*_values(emitter, set())) for emitter in free]
    return {
        "geometry": [float(moments[0]), *(moments[1:] / max(moments[0], 1e-30)).tolist()],
        "materials": dict(sorted(areas.items())),
        "lights": sorted(lights),
    }


def changed_parts(
    first: Mapping[str, Any], second: Mapping[str, Any], tolerance: float = SAME
) -> list[str]:
    """The parts in which two fingerprints differ; fingerprints of earlier versions match any."""
    return [part for part in PARTS if not _same(part, first, second, tolerance)]


def _same(part: str, first: Mapping[str, Any], second: Mapping[str, Any], tolerance: float) -> bool:
    ours, theirs = first.get(part), second.get(part)
    if type(ours) is not type(theirs) or isinstance(ours, str):
        return True  # an earlier version had digests of individual shapes
    if part == "geometry":
        a, b = np.array(ours), np.array(theirs)
        # Lengths and squared lengths are compared relative to the size of the scene.
        size = np.sqrt(max(a[4:7].sum(), b[4:7].sum()))
        units = np.array([max(a[0], b[0]), *[size] * 3, *[size**2] * 6])
        return bool((np.abs(a - b) <= tolerance * units).all())
    if part == "materials" and ours.keys() == theirs.keys():  # type: ignore[union-attr]
        if not _same("geometry", first, second, tolerance):
            return True  # then areas differ too
        areas = np.array([[ours[name], theirs[name]] for name in ours])  # type: ignore[index,union-attr]
        return bool((np.abs(areas[:, 0] - areas[:, 1]) <= tolerance * areas.sum()).all())
    return bool(ours == theirs)


def _moments(shape: mi.Shape) -> np.ndarray:
    """Area A of a shape, and the integrals over it of x, y, z, x², y², z², yz, zx, xy, (10,).

    A shape that is neither a mesh nor a rectangle counts as its bounding box.
    """
    if isinstance(shape, mi.Mesh):
        vertices = np.array(shape.vertex_positions_buffer(), dtype=float).reshape(-1, 3)
        faces = np.array(shape.faces_buffer(), dtype=np.int64).reshape(-1, 3)
        corners = vertices[faces]
    elif shape.class_name() == "Rectangle":
        matrix = np.array(mi.traverse(shape)["to_world"].matrix, dtype=float).reshape(4, 4)
        square = np.array([[-1, -1, 0, 1], [1, -1, 0, 1], [1, 1, 0, 1], [-1, 1, 0, 1.0]])
        corners = (square @ matrix.T)[:, :3][np.array([[0, 1, 2], [0, 2, 3]])]
    else:
        box = shape.bbox()
        centre, extent = np.array(box.center()), np.array(box.extents())
        try:
            area = float(np.array(shape.surface_area()).ravel()[0])
        except RuntimeError:  # curves, ellipsoids and instances do not know their area
            area = 2 * float(extent @ np.roll(extent, 1))
        square = np.outer(centre, centre) + np.diag(extent**2) / 12
        return area * np.array([1, *centre, *np.diag(square), *square[[1, 2, 0], [2, 0, 1]]])
    sides = corners[:, 1:] - corners[:, :1]
    area = 0.5 * np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    total = corners.sum(axis=1)
    first = area @ total / 3
    both = np.einsum("t,tki,tkj->ij", area, corners, corners)
    both = (both + np.einsum("t,ti,tj->ij", area, total, total)) / 12
    return np.array([area.sum(), *first, *np.diag(both), *both[[1, 2, 0], [2, 0, 1]]])


def _digest(*facts: bytes) -> str:
    """Digest of the facts as a set: a texture that two parts share may be found once or twice."""
    return hashlib.sha256(b"\0".join(sorted(set(facts)))).hexdigest()[:16]


def _values(thing: Any, without: set[Any]) -> Iterator[bytes]:
    """The class and the values of an object and its children, except those in ``without``."""
    yield thing.class_name().encode()
    for key, value, owner in parameters(thing):
        if owner not in without:
            # Only for transforms: the `matrix` of a colour would be a swizzle of its channels.
            value = value.matrix if hasattr(type(value), "matrix") else value
            # A copy: reading the value of a phase function itself would make it an array in memory,
            # which recorded functions do not find.
            value = type(value)(value)
            yield key.rpartition(".")[2].encode() + np.array(value).tobytes()

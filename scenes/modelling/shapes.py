"""Cameras, lamps, boxes and rooms as entries of a dictionary for :func:`mitsuba.load_dict`.

y is up; lengths are metres. A scene is the union of dictionaries: ``camera(…) | room(…) | {…}``.
"""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np

from gpf.core.structs import from_numpy
from gpf.modelling.meshes import Mesh

Dict = dict[str, Any]
Vector = tuple[float, ...]

WHITE, GREY, RED, GREEN, BLUE, WOOD = (
    (0.75, 0.75, 0.75),
    (0.45, 0.45, 0.45),
    (0.6, 0.08, 0.06),
    (0.12, 0.45, 0.1),
    (0.12, 0.2, 0.55),
    (0.5, 0.32, 0.18),
)

# Rotations of Mitsuba's rectangle, which faces +z: axis and degrees.
_FACING = {
    "front": ((0, 1, 0), 0),
    "back": ((0, 1, 0), 180),
    "right": ((0, 1, 0), 90),
    "left": ((0, 1, 0), -90),
    "up": ((1, 0, 0), -90),
    "down": ((1, 0, 0), 90),
}


def rgb(colour: Vector) -> Dict:
    """A colour: reflectances or radiances, (3,)."""
    return {"type": "rgb", "value": list(colour)}


def diffuse(colour: Vector) -> Dict:
    """A material that is diffuse on both sides."""
    return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": rgb(colour)}}


def camera(origin: Vector, target: Vector, fov: float) -> Dict:
    """The beginning of a scene: its sensor, 96 × 72 pixels; ``fov`` in degrees."""
    film = {"type": "hdrfilm", "width": 96, "height": 72, "rfilter": {"type": "box"}}
    place = mi.ScalarTransform4f().look_at(list(origin), list(target), [0, 1, 0])
    return {
        "type": "scene",
        "camera": {"type": "perspective", "fov": fov, "to_world": place, "film": film},
    }


def rectangle(
    centre: Vector, half: tuple[float, float], facing: str, colour: Vector = WHITE
) -> Dict:
    """A rectangle that faces ``front`` (+z), ``back``, ``right`` (+x), ``left``, ``up`` or
    ``down``; ``half``: half of its width and height."""
    axis, degrees = _FACING[facing]
    place = mi.ScalarTransform4f().translate(list(centre)).rotate(list(axis), degrees)
    return {
        "type": "rectangle",
        "to_world": place.scale([half[0], half[1], 1]),
        "bsdf": diffuse(colour),
    }


def lamp(centre: Vector, half: tuple[float, float], radiance: float) -> Dict:
    """A rectangle that shines downwards."""
    emitter = {"type": "area", "radiance": rgb((radiance, 0.95 * radiance, 0.85 * radiance))}
    return rectangle(centre, half, "down", GREY) | {"emitter": emitter}


def box(centre: Vector, half: Vector, colour: Vector = WHITE) -> Dict:
    """A box; ``half``: half of its size."""
    place = mi.ScalarTransform4f().translate(list(centre)).scale(list(half))
    return {"type": "cube", "to_world": place, "bsdf": diffuse(colour)}


def sphere(centre: Vector, radius: float, bsdf: Dict) -> Dict:
    """A ball."""
    return {"type": "sphere", "center": list(centre), "radius": radius, "bsdf": bsdf}


def triangles(mesh: Mesh, bsdf: Dict, facetted: bool = True) -> mi.Mesh:
    """A mesh as a shape; without ``facetted``, its normals are smooth."""
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(bsdf)
    properties["face_normals"] = facetted
    has_uv = mesh.uv is not None
    shape = mi.Mesh(
        "mesh", len(mesh.points), len(mesh.faces), props=properties, has_vertex_texcoords=has_uv
    )
    values = mi.traverse(shape)
    columns = {"vertex_positions": mesh.points}
    if mesh.uv is not None:
        columns["vertex_texcoords"] = mesh.uv
    for name, column in columns.items():
        values[name] = from_numpy(mi.Float, column.astype(np.float32).ravel())
    values["faces"] = from_numpy(mi.UInt32, mesh.faces.astype(np.uint32).ravel())
    values.update()
    return shape


def walls(size: Vector, names: tuple[str, ...]) -> Dict:
    """Some walls of a room, with the origin in the middle of its floor."""
    x, y, z = size[0] / 2, size[1], size[2] / 2
    every = {
        "floor": rectangle((0, 0, 0), (x, z), "up", WOOD),
        "ceiling": rectangle((0, y, 0), (x, z), "down", WHITE),
        "left": rectangle((-x, y / 2, 0), (z, y / 2), "right", RED),
        "right": rectangle((x, y / 2, 0), (z, y / 2), "left", GREEN),
        "back": rectangle((0, y / 2, -z), (x, y / 2), "front", WHITE),
        "front": rectangle((0, y / 2, z), (x, y / 2), "back", WHITE),
    }
    return {name: every[name] for name in names}


def room(size: Vector) -> Dict:
    """Floor, ceiling and four walls."""
    return walls(size, ("floor", "ceiling", "left", "right", "back", "front"))

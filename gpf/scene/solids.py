"""Solids of glass or water that overlap, which no renderer without priorities can refract."""

from __future__ import annotations

from collections import Counter

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.structs import from_numpy
from gpf.scene.bounds import scene_bounds
from gpf.scene.shapes import all_shapes

OVERLAP = (
    "%s and %s overlap: light in both is refracted as if it were in the last that it met. Leave a "
    "gap, or let one surface part them, with the int_ior and the ext_ior of its two sides."
)

_RAYS, _CROSSINGS = 4096, 24

# Rays along an edge can miss one of two surfaces.
_LEAST = 4


def overlapping_solids(scene: mi.Scene) -> list[tuple[str, str]]:
    """The pairs of refracting shapes that overlap: rays, from outside and straight on through
    everything, leave the one before they leave the other, which they have entered later. Rays that
    stay in a shape tell nothing: it is an open sheet."""
    shapes = [shape for shape in all_shapes(scene) if _is_solid(shape.bsdf())]
    if len(shapes) < 2:
        return []
    pointers = (dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape)) for shape in shapes)
    names = (shape.id() or f"a shape ({shape.class_name()})" for shape in shapes)
    solids = {int(k[0]): name for k, name in zip(pointers, names, strict=True)}
    lower, upper = scene_bounds(scene)
    length = float(dr.norm(upper - lower))
    rng = np.random.default_rng(0)
    direction = rng.normal(size=(_RAYS, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    boxes = np.array([[shape.bbox().min, shape.bbox().max] for shape in shapes])
    aim = boxes[rng.integers(0, len(shapes), _RAYS)]
    origin = rng.uniform(aim[:, 0], aim[:, 1]) - length * direction
    ray = mi.Ray3f(from_numpy(mi.Point3f, origin), from_numpy(mi.Vector3f, direction))
    active = dr.full(mi.Bool, True, _RAYS)
    inside: list[list[int]] = [[] for _ in range(_RAYS)]
    crossed: list[set[tuple[str, str]]] = [set() for _ in range(_RAYS)]
    for _ in range(_CROSSINGS):
        si = scene.ray_intersect(ray, mi.RayFlags.Minimal, False, active)
        active &= si.is_valid()
        index = dr.select(active, dr.reinterpret_array(mi.UInt32, si.shape), 0).numpy()
        for k in np.flatnonzero(np.isin(index, list(solids))):
            met, entered = int(index[k]), inside[k]
            if met not in entered:
                entered.append(met)
                continue
            if entered[-1] != met:
                first, second = sorted((solids[met], solids[entered[-1]]))
                crossed[k].add((first, second))
            entered.remove(met)
        ray = si.spawn_ray(ray.d)
        dr.eval(ray, active)
    left = (pairs for pairs, entered in zip(crossed, inside, strict=True) if not entered)
    found = Counter(pair for pairs in left for pair in pairs)
    return sorted(pair for pair, rays in found.items() if rays >= _LEAST)


def _is_solid(bsdf: mi.BSDF | None) -> bool:
    """Whether light enters another substance at surfaces of a material."""
    through = int(mi.BSDFFlags.DeltaTransmission) | int(mi.BSDFFlags.GlossyTransmission)
    return bsdf is not None and bool(bsdf.flags() & through) and "Thin" not in bsdf.class_name()

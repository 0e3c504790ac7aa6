"""Solids of glass or water that overlap, which no renderer without priorities can refract."""

from __future__ import annotations

from collections import Counter

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.structs import from_numpy
from gpf.scene.bounds import scene_bounds, shape_box
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
    solids = {_number(shape): shape for shape in all_shapes(scene) if _is_solid(shape.bsdf())}
    solids = {k: s for k, s in solids.items() if np.isfinite(shape_box(s)).all()}
    if len(solids) < 2:
        return []
    names = {k: s.id() or f"a shape ({s.class_name()})" for k, s in solids.items()}
    boxes = np.array([shape_box(shape) for shape in solids.values()])
    rng, (lower, upper) = np.random.default_rng(0), scene_bounds(scene)
    aim = boxes[rng.integers(0, len(boxes), _RAYS)]
    to = from_numpy(mi.Point3f, rng.uniform(aim[:, 0], aim[:, 1]))
    d = mi.warp.square_to_uniform_sphere(from_numpy(mi.Point2f, rng.random((_RAYS, 2))))
    ray, active = mi.Ray3f(to - dr.norm(upper - lower) * d, d), dr.full(mi.Bool, True, _RAYS)
    inside: list[list[int]] = [[] for _ in range(_RAYS)]
    crossed: list[set[tuple[str, str]]] = [set() for _ in range(_RAYS)]
    for _ in range(_CROSSINGS):
        # In a scene of many meshes, a full intersection takes twenty times as long.
        hit = scene.ray_intersect_preliminary(ray, active=active)
        active &= hit.is_valid()
        index = dr.select(active, dr.reinterpret_array(mi.UInt32, hit.shape), 0).numpy()
        for k in np.flatnonzero(np.isin(index, list(solids))):
            met, entered = int(index[k]), inside[k]
            if met not in entered:
                entered.append(met)
                continue
            if entered[-1] != met:
                first, second = sorted((names[met], names[entered[-1]]))
                crossed[k].add((first, second))
            entered.remove(met)
        p = ray(dr.select(active, hit.t, 0))
        ray.o = p + (1 + dr.max(dr.abs(p))) * mi.math.RayEpsilon * ray.d
        dr.eval(ray, active)
    left = (pairs for pairs, entered in zip(crossed, inside, strict=True) if not entered)
    found = Counter(pair for pairs in left for pair in pairs)
    return sorted(pair for pair, rays in found.items() if rays >= _LEAST)


def _number(shape: mi.Shape) -> int:
    return int(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape))[0])


def _is_solid(bsdf: mi.BSDF | None) -> bool:
    """Whether light enters another substance at surfaces of a material."""
    through = int(mi.BSDFFlags.DeltaTransmission) | int(mi.BSDFFlags.GlossyTransmission)
    return bsdf is not None and bool(bsdf.flags() & through) and "Thin" not in bsdf.class_name()

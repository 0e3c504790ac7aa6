"""What surfaces reflect and emit, as seen along their normals."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.baking.bake import LightMaps
from gpf.baking.surfaces import Surface
from gpf.baking.texels import fill_page
from gpf.core.structs import from_numpy, to_numpy
from gpf.scene.materials import diffuse_reflectance

BLACK = 1e-3
"""Reflectance that is none."""


def bake_radiosity(
    scene: mi.Scene,
    baked: LightMaps,
    members: Mapping[str, Sequence[int]],
    apart: Collection[str] = (),
) -> dict[str, np.ndarray]:
    """What leaves the fronts of surfaces in their light maps: ρ E + π L_e.

    Parameters
    ----------
    members: the indices in ``scene.emitters()`` of each group's emitters, by its name.
    apart: names of surfaces for which ρ is left out.

    Returns
    -------
    W/m² by the names of ``baked.maps``, (H, W, 3) float32 each.
    """
    count = len(baked.places.index)
    reflectance, emission = np.ones((count, 3), np.float32), np.zeros((count, 3), np.float32)
    group = np.full(count, "", dtype=object)
    first = 0
    for chart in baked.atlas.charts:
        surface, last = chart.surface, first + len(chart.faces)
        here = (baked.places.triangle >= first) & (baked.places.triangle < last)
        faces, weights = baked.places.triangle[here] - first, baked.places.weights[here]
        first = last
        if surface.name in apart or not len(faces):
            continue
        si = from_front(surface, faces, weights)
        reflectance[here] = to_numpy(diffuse_reflectance(surface.shape.bsdf(), si, mi.Bool(True)))
        if surface.shape.is_emitter():
            emission[here] = to_numpy(surface.shape.emitter().eval(si))
            group[here] = group_of_emitter(scene, surface.shape.emitter(), members)

    def page(values: np.ndarray) -> np.ndarray:
        return fill_page(values, np.full(count, True), baked.places, baked.atlas.size)

    albedo = page(reflectance)
    radiosity = {}
    for name, light in baked.maps.items():
        own = emission if not name else np.where((group == name)[:, None], emission, 0)
        radiosity[name] = albedo * light + (np.pi * page(own) if own.any() else 0)
    return radiosity


def group_of_emitter(
    scene: mi.Scene, emitter: mi.Emitter, members: Mapping[str, Sequence[int]]
) -> str:
    """The name of an emitter's group of lights; empty if there are no groups."""
    number = scene.emitters().index(emitter)
    return next((name for name, own in members.items() if number in own), "")


def is_black(surface: Surface) -> bool:
    """Whether a surface has no diffuse reflectance anywhere."""
    faces = np.arange(len(surface.faces))
    si = from_front(surface, faces, np.full((len(faces), 3), 1 / 3))
    found = diffuse_reflectance(surface.shape.bsdf(), si, mi.Bool(True))
    return bool(np.array(dr.max(found, axis=None))[0] < BLACK)


def emitted_by(surface: Surface) -> np.ndarray:
    """The mean radiance of a luminous surface, W/(m² sr), (3,)."""
    faces = np.arange(len(surface.faces))
    si = from_front(surface, faces, np.full((len(faces), 3), 1 / 3))
    light = rows(surface.shape.emitter().eval(si), len(faces))
    return np.average(light, axis=0, weights=surface.areas)


def from_front(surface: Surface, faces: np.ndarray, weights: np.ndarray) -> mi.SurfaceInteraction3f:
    """Points on triangles (as for :meth:`Surface.at`), seen along their normals."""
    p, n = surface.at(faces, weights)
    uv = np.zeros((len(p), 2), np.float32)
    if surface.uv is not None:
        uv = np.einsum("pk,pki->pi", weights, surface.uv[surface.faces[faces]])
    return _interactions(surface, p, n, uv, faces)


def at_coordinates(surface: Surface, uv: np.ndarray) -> mi.SurfaceInteraction3f:
    """What texture coordinates look like on a surface, (P, 2): seen along its normals, anywhere."""
    count = len(uv)
    p, n = surface.at(np.zeros(1, int), np.full((1, 3), 1 / 3))
    return _interactions(
        surface, np.repeat(p, count, 0), np.repeat(n, count, 0), uv, np.zeros(count, int)
    )


def rows(colours: mi.Color3f, count: int) -> np.ndarray:
    """Colours as (N, 3), also if they are the same everywhere and Dr.Jit has them only once."""
    return np.broadcast_to(to_numpy(mi.Color3f(colours)), (count, 3))


def _interactions(
    surface: Surface, p: np.ndarray, n: np.ndarray, uv: np.ndarray, faces: np.ndarray
) -> mi.SurfaceInteraction3f:
    si = dr.zeros(mi.SurfaceInteraction3f, len(p))
    si.p, si.n = from_numpy(mi.Point3f, p), from_numpy(mi.Normal3f, n)
    si.sh_frame = mi.Frame3f(si.n)
    si.dp_du, si.dp_dv = si.sh_frame.s, si.sh_frame.t
    si.uv = from_numpy(mi.Point2f, uv.astype(np.float32))
    si.wi = mi.Vector3f(0, 0, 1)
    si.prim_index = from_numpy(mi.UInt32, faces.astype(np.uint32))
    si.shape = mi.ShapePtr(surface.shape)
    return si

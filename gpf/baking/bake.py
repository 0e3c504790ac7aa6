"""From a scene and its field to light maps, or to light at vertices."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mitsuba as mi
import numpy as np

from gpf.baking.atlas import Atlas
from gpf.baking.light import SAMPLES, BakedLight, bake_light
from gpf.baking.surfaces import Surface, read_surfaces
from gpf.baking.texels import Texels, fill_page, find_texels
from gpf.core.errors import UserError
from gpf.core.machine import require_memory
from gpf.field.field import GaussianPhotonField

Report = Callable[[int, int], object]
"""Called with the numbers of points that are done and of all points."""


@dataclass(frozen=True)
class LightMaps:
    """Light maps of a scene: all its surfaces share one page.

    Attributes
    ----------
    maps: irradiance by the names of the light groups, W/m², (H, W, 3) float32 each; under the empty
        name, that of all lamps together.
    places: where the texels lie on surfaces.
    """

    atlas: Atlas
    maps: dict[str, np.ndarray]
    places: Texels

    @property
    def texels(self) -> int:
        """The number of texels that lie on surfaces."""
        return len(self.places.index)


@dataclass(frozen=True)
class LitVertices:
    """A surface with light at its vertices.

    Attributes
    ----------
    vertices: the surface's vertex that each of these repeats, (V,); a faceted surface has three for
        each triangle.
    faces: indices of these vertices, (M, 3).
    light: irradiance by the names of the light groups, W/m², (V, 3) float32; under the empty name,
        that of all lamps together.
    """

    surface: Surface
    vertices: np.ndarray
    faces: np.ndarray
    light: dict[str, np.ndarray]


# Bytes of memory for each texel, at least.
PER_TEXEL = 100

# Vertices take the light of points this much farther inside their triangles: exactly in a corner of
# a room, rays towards lamps would start inside the walls.
INSIDE = 0.02


def surfaces_to_bake(scene: mi.Scene) -> tuple[list[Surface], dict[str, str]]:
    """The surfaces that light can be baked on, and why others are left out, by their names.

    Raises
    ------
    UserError: there is none.
    """
    surfaces, left_out = read_surfaces(scene)
    if not surfaces:
        raise UserError(
            "scene", "has no diffuse surface that light can be baked on", "Use meshes, or spheres."
        )
    return surfaces, left_out


def bake_maps(
    scene: mi.Scene,
    field: GaussianPhotonField,
    atlas: Atlas,
    samples: int = SAMPLES,
    seed: int = 0,
    report: Report = lambda done, total: None,
) -> LightMaps:
    """The light at the texels of an atlas (:func:`gpf.baking.atlas.unwrap`).

    Parameters
    ----------
    samples: samples of the lamps whose direct light the field leaves out, per texel.

    Raises
    ------
    UserError: as :func:`gpf.baking.light.bake_light`, or there is too little memory.
    """
    width, height = atlas.size
    require_memory("The light map", f"{width}x{height}", PER_TEXEL * width * height)
    texels = find_texels(atlas.triangles, atlas.size)
    p, n = atlas.at(texels.triangle, texels.weights)
    light = bake_light(scene, field, p, n, samples, seed, lambda done: report(done, len(p)))
    maps = {
        name: fill_page(values, light.known, texels, atlas.size)
        for name, values in _with_total(light).items()
    }
    return LightMaps(atlas, maps, texels)


def bake_vertices(
    scene: mi.Scene,
    field: GaussianPhotonField,
    surfaces: Sequence[Surface],
    samples: int = SAMPLES,
    seed: int = 0,
    report: Report = lambda done, total: None,
) -> list[LitVertices]:
    """The light at the vertices of surfaces: at a vertex of a smooth surface, the mean over its
    triangles, weighted by area. The parameters are those of :func:`bake_maps`.

    Raises
    ------
    UserError: as :func:`gpf.baking.light.bake_light`.
    """
    counts = [3 * len(surface.faces) for surface in surfaces]
    weights = np.full((3, 3), INSIDE / 3) + (1 - INSIDE) * np.eye(3)
    places = [
        surface.at(np.repeat(np.arange(len(surface.faces)), 3), np.tile(weights, (count // 3, 1)))
        for surface, count in zip(surfaces, counts, strict=True)
    ]
    p, n = (np.concatenate(parts) for parts in zip(*places, strict=True))
    light = bake_light(scene, field, p, n, samples, seed, lambda done: report(done, len(p)))
    lit, first = [], 0
    for surface, count in zip(surfaces, counts, strict=True):
        corners = {k: v[first : first + count] for k, v in _with_total(light).items()}
        lit.append(_join_corners(surface, corners))
        first += count
    return lit


def _join_corners(surface: Surface, corners: dict[str, np.ndarray]) -> LitVertices:
    """Light at vertices from the light at the corners of all triangles, (3 M, 3)."""
    owner = surface.faces.ravel()
    if surface.normals is None:
        own = np.arange(len(owner), dtype=np.uint32)
        return LitVertices(surface, owner, own.reshape(-1, 3), corners)
    area, count = np.repeat(surface.areas, 3), len(surface.points)
    area = np.maximum(area, 1e-9 * area.max())  # a vertex may have triangles without area only
    whole = np.maximum(np.bincount(owner, area, count), 1e-30)[:, None]
    light = {
        name: np.stack([np.bincount(owner, area * v, count) for v in values.T], axis=1) / whole
        for name, values in corners.items()
    }
    light = {name: values.astype(np.float32) for name, values in light.items()}
    return LitVertices(surface, np.arange(count), surface.faces, light)


def _with_total(light: BakedLight) -> dict[str, np.ndarray]:
    return {"": light.total, **{name: v for name, v in light.groups.items() if name}}

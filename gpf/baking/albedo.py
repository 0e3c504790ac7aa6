"""The diffuse reflectance of surfaces as a colour and an image, in the image's own resolution."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import mitsuba as mi
import numpy as np

from gpf.baking.reflectance import at_coordinates, from_front, rows
from gpf.baking.surfaces import Surface
from gpf.core.images import tone_map
from gpf.core.structs import to_numpy
from gpf.scene.materials import diffuse_reflectance

# Points of a surface where its reflectance is compared, and what counts as equal.
SAMPLES, SAME = 512, 0.01

WRAPS = {"repeat": 10497, "mirror": 33648, "clamp": 33071}
"""What is beyond the edges of an image, and the numbers that glTF has for it."""


@dataclass(frozen=True)
class Albedo:
    """A reflectance.

    Attributes
    ----------
    factor: (3,); multiplies the image.
    image: sRGB, (H, W, 3) uint8, or None.
    uv: coordinates of the surface's points on the image, (N, 2).
    wrap: one of :data:`WRAPS`.
    """

    factor: np.ndarray
    image: np.ndarray | None = None
    uv: np.ndarray | None = None
    wrap: str = "repeat"


def read_albedos(surfaces: Iterable[Surface]) -> dict[str, Albedo]:
    """The reflectances of surfaces for which :func:`read_albedo` has one, by their names; lamps
    have none."""
    dark = [surface for surface in surfaces if not surface.shape.is_emitter()]
    found = {surface.name: read_albedo(surface) for surface in dark}
    return {name: albedo for name, albedo in found.items() if albedo is not None}


def read_albedo(surface: Surface) -> Albedo | None:
    """The reflectance of a surface; None if it is neither constant nor that of a single image."""
    rng = np.random.default_rng(0)
    areas = surface.areas
    faces = rng.choice(len(areas), SAMPLES, p=areas / areas.sum())
    si = from_front(surface, faces, rng.dirichlet([1, 1, 1], SAMPLES))
    found = to_numpy(diffuse_reflectance(surface.shape.bsdf(), si, mi.Bool(True)))
    if np.ptp(found, axis=0).max() < SAME:
        return Albedo(found.mean(axis=0))
    place = to_numpy(mi.Point2f(si.uv))
    for texture in mi.traverse(surface.shape.bsdf()).hierarchy:
        if surface.uv is None or not texture.class_name().startswith("BitmapTexture"):
            continue
        parameters = mi.traverse(texture)
        to_uv = np.array(parameters["to_uv"].matrix, dtype=float).reshape(3, 3)
        image = _texels(surface, texture, to_uv)
        for wrap in WRAPS:
            seen = _look_up(image, _moved(place, to_uv), wrap)
            factor = (seen * found).sum(axis=0) / np.maximum((seen * seen).sum(axis=0), 1e-9)
            off = np.abs(factor * seen - found).max(axis=1)
            if factor.max() <= 1 + SAME and np.mean(off < SAME) > 0.98:
                encoded = np.round(255 * tone_map(image, 1)).astype(np.uint8)
                uv = _moved(surface.uv, to_uv).astype(np.float32)
                return Albedo(np.minimum(factor, 1), encoded, uv, wrap)
    return None


def _moved(uv: np.ndarray, to_uv: np.ndarray) -> np.ndarray:
    return np.asarray(uv @ to_uv[:2, :2].T + to_uv[:2, 2])


def _texels(surface: Surface, texture: mi.Texture, to_uv: np.ndarray) -> np.ndarray:
    """The linear colours of a texture's image, (H, W, 3)."""
    width, height = (int(n) for n in texture.resolution())
    grid = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).reshape(-1, 2)
    uv = _moved((grid + 0.5) / [width, height], np.linalg.inv(to_uv))
    return rows(texture.eval(at_coordinates(surface, uv)), len(uv)).reshape(height, width, 3)


def _look_up(image: np.ndarray, uv: np.ndarray, wrap: str) -> np.ndarray:
    """Bilinear lookups in an image, (P, 3)."""
    size = np.array(image.shape[1::-1])
    place = uv * size - 0.5
    low = np.floor(place).astype(int)
    part = (place - low)[:, :, None]

    def texel(dx: int, dy: int) -> np.ndarray:
        index = low + np.array([dx, dy])
        if wrap == "repeat":
            index = index % size
        elif wrap == "mirror":
            index = np.minimum(index % (2 * size), 2 * size - 1 - index % (2 * size))
        else:
            index = np.clip(index, 0, size - 1)
        return np.asarray(image[index[:, 1], index[:, 0]])

    upper = (1 - part[:, 0]) * texel(0, 0) + part[:, 0] * texel(1, 0)
    lower = (1 - part[:, 0]) * texel(0, 1) + part[:, 0] * texel(1, 1)
    return np.asarray((1 - part[:, 1]) * upper + part[:, 1] * lower)

"""How surfaces reflect and transmit light apart from their diffuse component, as glTF says it."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.baking.reflectance import at_coordinates, from_front, rows
from gpf.baking.surfaces import Surface
from gpf.core.random import next_1d, next_2d
from gpf.scene.materials import NOT_DIFFUSE, has_diffuse, specular_context

SAMPLES = 64
"""Samples of a BSDF, per point."""

TEXTURE = 512
"""Width and height of the texture of a metal whose reflectance varies."""

# Differences in reflectance that are noise of the samples.
SAME = 0.02

# Roughness from which reflections are too blurred to be seen.
DULL = 0.7

# Less transmission than this is none.
OPAQUE = 0.01


@dataclass(frozen=True)
class Finish:
    """A finish of a surface.

    Attributes
    ----------
    colour: reflectance of a metal, or transmittance of glass apart from Fresnel's share, along the
        normal: (3,), or a texture (H, W, 3) over the extent of the surface's own coordinates.
    roughness: as in glTF: the square root of the width α of the distribution of microfacets.
    transmits: whether it is glass.
    ior: index of refraction of what is behind the surface; 1 for a thin pane.
    """

    colour: np.ndarray
    roughness: float
    transmits: bool
    ior: float

    @property
    def bends(self) -> bool:
        """Whether light changes its direction in it."""
        return self.ior > 1


def read_finish(surface: Surface) -> Finish:
    """The finish of a surface without a diffuse component."""
    rough = _roughness(surface.shape.bsdf())
    low, high = uv_extent(surface)
    some = np.random.default_rng(0).uniform(low, high, (256, 2))
    back, through, eta = _sampled(surface, some)
    if through.mean() < OPAQUE:
        colour = back.mean(axis=0)
        if back.std(axis=0).max() > SAME:
            grid = (np.stack(np.meshgrid(*2 * [np.arange(TEXTURE)]), axis=-1) + 0.5) / TEXTURE
            colour = _sampled(surface, (low + grid * (high - low)).reshape(-1, 2))[0]
            colour = colour.reshape(TEXTURE, TEXTURE, 3)
        return Finish(np.clip(colour, 0, 1), rough, False, 1.0)
    ior = max(eta, 1 / eta)
    share = ((ior - 1) / (ior + 1)) ** 2
    return Finish(np.clip(through.mean(axis=0) / (1 - share), 0, 1), rough, True, ior)


def read_gloss(surface: Surface) -> float | None:
    """The roughness of a surface's reflections; None if they are dull, or it has none."""
    others = int(surface.shape.bsdf().flags()) & NOT_DIFFUSE & int(mi.BSDFFlags.Reflection)
    rough = _roughness(surface.shape.bsdf())
    return rough if others and rough < DULL else None


def look_behind(scene: mi.Scene, surface: Surface) -> tuple[float, float]:
    """The mean distance from a surface to what is behind it, world units, and the share of places
    where that is a diffuse surface, so that light does not leave the glass again."""
    rng = np.random.default_rng(0)
    areas = surface.areas
    faces = rng.choice(len(areas), 1024, p=areas / areas.sum())
    si = from_front(surface, faces, rng.dirichlet([1, 1, 1], len(faces)))
    hit = scene.ray_intersect(si.spawn_ray(-si.n))
    valid, ends = np.array(hit.is_valid()), np.array(has_diffuse(hit.bsdf(), hit))
    if not valid.any():
        return 0.0, 0.0
    return float(np.array(hit.t)[valid].mean()), float(ends[valid].mean())


def uv_extent(surface: Surface) -> np.ndarray:
    """The smallest and the largest texture coordinates of a surface, (2, 2)."""
    if surface.uv is None:
        return np.array([[0.0, 0], [1, 1]])
    used = surface.uv[np.unique(surface.faces)]
    return np.stack([used.min(axis=0), used.max(axis=0)])


def _roughness(bsdf: mi.BSDF) -> float:
    """The roughness of a BSDF as in glTF; 0 for smooth ones."""
    parameters = mi.traverse(bsdf)

    def mean(*ends: str) -> float | None:
        found = [
            np.mean(np.array(parameters[key]))
            for key in parameters.keys()  # noqa: SIM118  # not a dictionary
            if key.removesuffix(".value").removesuffix(".data").split(".")[-1] in ends
        ]
        return float(np.mean(found)) if found else None

    given, alpha = mean("roughness"), mean("alpha", "alpha_u", "alpha_v")
    return min(given if given is not None else (alpha or 0.0) ** 0.5, 1.0)


def _sampled(surface: Surface, uv: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Mean reflectance and transmittance along the normal, (P, 3) each, and the relative index of
    refraction, at texture coordinates (P, 2)."""
    si = at_coordinates(surface, np.repeat(uv, SAMPLES, axis=0))
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(0, SAMPLES * len(uv))
    # As light goes: radiance would change with the index of refraction.
    context = specular_context(mi.TransportMode.Importance)
    every = mi.Bool(True)
    first, second = next_1d(sampler, every), next_2d(sampler, every)
    found, weight = surface.shape.bsdf().sample(context, si, first, second)
    passes = np.broadcast_to(np.array(found.wo.z) < 0, SAMPLES * len(uv))
    weight = rows(dr.select(found.pdf > 0, weight, 0), len(passes))
    parts = (np.where(side[:, None], weight, 0) for side in (~passes, passes))
    back, through = (part.reshape(len(uv), SAMPLES, 3).mean(axis=1) for part in parts)
    eta = np.broadcast_to(np.array(found.eta), passes.shape)[passes]
    return back, through, float(eta.mean()) if len(eta) else 1.0

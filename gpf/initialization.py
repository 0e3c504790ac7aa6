"""Photons -> initial Gaussians."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.density import PhotonDensity
from gpf.gaussians import Gaussians
from gpf.spatial_hash import SpatialHash
from gpf.structs import Photons, concatenate, take


@dataclass(frozen=True)
class InitializationSettings:
    """How the Gaussians start.

    Attributes
    ----------
    gaussians: number M of primitives.
    source: ``photons``: means and normals of M photons, chosen at random; ``random``: means are
        uniform in the scene's bounding box, with the normal of the nearest photon.
    colour: ``density``: kernel estimate of E at the Gaussian; ``flux``: the photon's own power Φ.
    scale: initial standard deviation of all axes, world units.
    density_radius: kernel radius of the estimate, world units.
    """

    gaussians: int = 100_000
    source: Literal["photons", "random"] = "photons"
    colour: Literal["density", "flux"] = "density"
    scale: float = 0.01
    density_radius: float = 0.02


def initialize_gaussians(
    photons: Photons,
    settings: InitializationSettings,
    bounds: tuple[Any, Any],
    seed: int,
    gaps: Photons | None = None,
) -> Gaussians:
    """One Gaussian for each of M photons: mean at the photon, random orientation, equal scales.

    With fewer than M photons, all of them are used: the field then has fewer Gaussians. Photons in
    ``gaps`` are among those in any case (:mod:`gpf.gap_filling`).
    """
    rng = np.random.default_rng(seed)
    available = dr.width(photons.p)
    filling = 0 if gaps is None else dr.width(gaps.p)
    count = min(settings.gaussians - filling, available)
    origins = take(
        photons, mi.UInt32(np.sort(rng.permutation(available)[:count]).astype(np.uint32))
    )
    if gaps is not None and filling:
        origins = concatenate([origins, gaps])
        count += filling
    means, normals, irradiance = origins.p, origins.n, origins.power
    if settings.source == "random":
        lower, upper = (np.array([b[i] for i in range(3)]) for b in bounds)
        means = mi.Point3f(rng.uniform(lower, upper, (count, 3)).T.astype(np.float32))
        cell = 1e-2 * float(np.linalg.norm(upper - lower))
        grid = SpatialHash(photons.p, cell=cell, bounds=bounds, far=True)
        nearest, _ = grid.nearest(means, 1, mi.Float(cell), mi.Float(2 * grid.extent))
        photon = dr.gather(mi.UInt32, grid.order, nearest[0])
        normals = dr.gather(mi.Normal3f, photons.n, photon)
    if settings.colour == "density":
        density = PhotonDensity(photons, settings.density_radius, bounds)
        irradiance = density.irradiance(means, normals)
    quats = rng.normal(size=(4, count)).astype(np.float32)
    gaussians = Gaussians(
        means=means,
        log_scales=dr.full(mi.Vector3f, float(np.log(settings.scale)), count),
        quats=mi.Quaternion4f(*(mi.Float(q) for q in quats)),
        irradiance=irradiance,
        normals=normals,
    )
    dr.eval(gaussians)
    return gaussians


def propose_search_radius(
    photons: Photons, gaussians: int, at: np.ndarray, bounds: tuple[Any, Any], neighbours: int = 16
) -> float:
    """A radius within which a typical supervised point has ``neighbours`` Gaussians.

    Measured as the median distance from up to 4096 of the points ``at`` (P, 3) to their nearest
    photons, with as many photons as there will be Gaussians.
    """
    rng = np.random.default_rng(0)
    available = dr.width(photons.p)
    chosen = mi.UInt32(rng.permutation(available)[:gaussians].astype(np.uint32))
    means = dr.gather(mi.Point3f, photons.p, chosen)
    diagonal = float(np.linalg.norm([bounds[1][i] - bounds[0][i] for i in range(3)]))
    grid = SpatialHash(means, cell=1e-2 * diagonal, bounds=bounds, far=True)
    sample = at[rng.integers(0, len(at), min(len(at), 4096))]
    x = mi.Point3f(np.ascontiguousarray(sample.T, dtype=np.float32))
    k = min(neighbours, dr.width(means))
    _, distance2 = grid.nearest(x, k, mi.Float(5e-3 * diagonal), mi.Float(grid.extent))
    return float(np.sqrt(np.median(distance2[k - 1].numpy())))

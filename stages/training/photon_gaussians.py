"""Initial Gaussians at photons, and the search radius for their number."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.spacing import measure_spacing
from gpf.core.spatial_hash import SpatialHash
from gpf.core.structs import OrientedPoints, Photons, concatenate, from_numpy, take
from gpf.field.gaussians import Gaussians
from gpf.photons.density import PhotonDensity
from stages.config.training import InitialFieldSettings


def propose_search_radius(
    photons: Photons, gaussians: int, at: np.ndarray, bounds: tuple[Any, Any], neighbours: int = 16
) -> float:
    """A radius, world units, within which a typical supervised point has ``neighbours`` Gaussians.

    The median, over up to 4096 of the points ``at`` (P, 3), of the distance to the n-th nearest
    photon, with n = ``neighbours`` and as many random photons as there will be Gaussians.
    """
    rng = np.random.default_rng(0)
    available = dr.width(photons.p)
    chosen = from_numpy(mi.UInt32, rng.permutation(available)[:gaussians])
    means = dr.gather(mi.Point3f, photons.p, chosen)
    sample = at[rng.integers(0, len(at), min(len(at), 4096))]
    k = min(neighbours, dr.width(means))
    return measure_spacing(means, from_numpy(mi.Point3f, sample), k, bounds)


def initialize_gaussians(
    photons: Photons,
    settings: InitialFieldSettings,
    bounds: tuple[Any, Any],
    seed: int,
    gaps: OrientedPoints | None = None,
) -> Gaussians:
    """M Gaussians: means at M random photons, random orientations, equal scales.

    The points of ``gaps`` (:func:`find_gaps`) take the place of as many photons; their initial
    irradiance is 0. With too few photons the field has fewer Gaussians.

    Parameters
    ----------
    settings: with numbers in place of ``auto``.
    bounds: corners of the scene's bounding box.
    gaps: points that always get a Gaussian, (G).
    """
    assert settings.gaussians != "auto" and settings.search_radius != "auto"
    assert settings.initial_scale != "auto"
    rng = np.random.default_rng(seed)
    available = dr.width(photons.p)
    filling = 0 if gaps is None else dr.width(gaps.p)
    count = min(settings.gaussians - filling, available)
    origins = take(photons, from_numpy(mi.UInt32, np.sort(rng.permutation(available)[:count])))
    means, normals, irradiance = origins.p, origins.n, origins.power
    if gaps is not None and filling:
        means, normals = concatenate([means, gaps.p]), concatenate([normals, gaps.n])
        irradiance = concatenate([irradiance, dr.zeros(mi.Color3f, filling)])
        count += filling
    if settings.initialization == "random":
        lower, upper = (np.array([b[i] for i in range(3)]) for b in bounds)
        means = from_numpy(mi.Point3f, rng.uniform(lower, upper, (count, 3)))
        cell = 1e-2 * float(np.linalg.norm(upper - lower))
        grid = SpatialHash(photons.p, cell=cell, bounds=bounds, far=True)
        nearest, _ = grid.nearest(means, 1, mi.Float(cell), mi.Float(2 * grid.levels.extent))
        photon = dr.gather(mi.UInt32, grid.order, nearest[0])
        normals = dr.gather(mi.Normal3f, photons.n, photon)
    if settings.initial_colour == "density":
        density = PhotonDensity(photons, settings.search_radius, bounds)
        irradiance = density.irradiance(means, normals)
    quats = rng.normal(size=(4, count)).T
    gaussians = Gaussians(
        means=means,
        log_scales=dr.full(mi.Vector3f, float(np.log(settings.initial_scale)), count),
        quats=from_numpy(mi.Quaternion4f, quats),
        irradiance=irradiance,
        normals=normals,
    )
    dr.eval(gaussians)
    return gaussians

"""Initial Gaussians, made from photons."""

from __future__ import annotations

import math
from typing import Any, Literal

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.settings import AutoCount, Length
from gpf.core.spatial_hash import SpatialHash
from gpf.core.structs import OrientedPoints, Photons, concatenate, from_numpy, take, to_numpy
from gpf.field.field import GaussianPhotonField
from gpf.field.gaussians import Gaussians
from gpf.field.io import Precision
from gpf.field.settings import FieldSettings
from gpf.guiding.density_control import oriented_places
from gpf.sppm.density import PhotonDensity

# Distance between Gaussians, in search radii: 16 Gaussians in the area of a search.
DISTANCE = math.sqrt(math.pi / 16)

# Initial standard deviation with ``initial_scale: auto``, in search radii.
TYPICAL_SCALE = 0.6


class InitialFieldSettings(FieldSettings):
    """Settings of a field: its query, and how its Gaussians start.

    Attributes
    ----------
    gaussians: number M of Gaussians; ``auto``: several numbers are tried in short training runs.
    initialization: ``photons``: means and normals of M random photons; ``random``: means uniform in
        the scene's bounding box, each with the normal of the nearest photon.
    fill_gaps: whether to place some of the Gaussians where cameras look but few photons land.
    initial_colour: ``targets``: the mean of the targets around the Gaussian; ``density``: kernel
        estimate of E at the Gaussian; ``flux``: the photon's own power Φ.
    initial_scale: standard deviation of all axes, world units; ``auto``: :data:`TYPICAL_SCALE`.
    direct: as for the field; ``auto``: direct light of lamps of zero or small size
        is sampled when a view is rendered (:func:`gpf.scene.lamps.small_lamps`).
    search_radius: world units; ``auto``: about 16 Gaussians around a typical point.
    anisotropic: whether the three scales of a Gaussian may differ.
    precision: precision of the field's file.
    """

    gaussians: AutoCount = "auto"
    initialization: Literal["photons", "random"] = "photons"
    fill_gaps: bool = True
    initial_colour: Literal["targets", "density", "flux"] = "targets"
    initial_scale: Length = "auto"
    search_radius: Length = "auto"  # type: ignore[assignment]
    direct: Literal["auto", "field", "emitters"] | tuple[int, ...] = "field"  # type: ignore[assignment]
    anisotropic: bool = True
    precision: Precision = "float32"

    def query(self, search_radius: float) -> FieldSettings:
        """The settings of the query, with the given search radius, world units."""
        common = {name: getattr(self, name) for name in FieldSettings.model_fields}
        return FieldSettings(**common | {"search_radius": search_radius})


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
        nearest, _ = grid.nearest(means, 1, mi.Float(cell), mi.Float(2 * grid.extent))
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
    diagonal = float(np.linalg.norm([bounds[1][i] - bounds[0][i] for i in range(3)]))
    grid = SpatialHash(means, cell=1e-2 * diagonal, bounds=bounds, far=True)
    sample = at[rng.integers(0, len(at), min(len(at), 4096))]
    x = from_numpy(mi.Point3f, sample)
    k = min(neighbours, dr.width(means))
    _, distance2 = grid.nearest(x, k, mi.Float(5e-3 * diagonal), mi.Float(grid.extent))
    return float(np.sqrt(np.median(distance2[k - 1].numpy())))


# Distance between the Gaussians in a gap, in search radii: about twelve within one search radius.
SPACING = 0.5

# Largest share of a field's Gaussians that may fill gaps.
MOST = 0.1


def find_gaps(
    field: GaussianPhotonField,
    position: np.ndarray,
    normal: np.ndarray,
    seed: int,
    spacing: float = SPACING,
    most: float = MOST,
) -> OrientedPoints:
    """Points whose search radius holds fewer than k Gaussians.

    At most one point per grid cell; surfaces that face different directions have separate cells.

    Parameters
    ----------
    field: a field without gap filling.
    position, normal: points where the field will be queried, world units and unit vectors, (P, 3).
    spacing: edge length of a cell, search radii.
    most: largest number of points, as a share of the field's Gaussians.
    """
    p, n = from_numpy(mi.Point3f, position), from_numpy(mi.Normal3f, normal)
    _, reach = field.query(p, n, dr.full(mi.Bool, True, len(position)))
    sparse = np.flatnonzero(reach.numpy() > 1)
    rng = np.random.default_rng(seed)
    rng.shuffle(sparse)
    width = spacing * field.settings.search_radius
    places = to_numpy(field.unfold(p))[sparse]
    cells = np.floor(oriented_places(places, normal[sparse], width) / width)
    _, first = np.unique(cells, axis=0, return_index=True)
    limit = int(most * dr.width(field.gaussians.means))
    chosen = np.sort(sparse[np.sort(first)[:limit]])
    return take(OrientedPoints(p=p, n=n), from_numpy(mi.UInt32, chosen))

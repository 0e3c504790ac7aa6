"""Where Gaussians start: their distances and sizes in search radii, and gaps between them."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.structs import OrientedPoints, from_numpy, take, to_numpy
from gpf.field.field import GaussianPhotonField
from gpf.guiding.density_control import oriented_places

# Distance between Gaussians, in search radii: 16 Gaussians in the area of a search.
DISTANCE = math.sqrt(math.pi / 16)

# Initial standard deviation with ``initial_scale: auto``, in search radii.
TYPICAL_SCALE = 0.6

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

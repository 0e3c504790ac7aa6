"""What the supervised points around each Gaussian say of the light there."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.spatial import cKDTree

from gpf.gaussians import Gaussians
from gpf.structs import SurfacePoints, to_numpy


def local_targets(
    gaussians: Gaussians, points: SurfacePoints, radius: float, neighbours: int = 8
) -> np.ndarray:
    """Mean target of the points that are nearest to each Gaussian on its surface, (N, 3).

    A right angle between two normals counts as 1.4 ``radius``, world units, the other side of a
    thin wall as 2: nearness alone would take the inside of a lamp for its outside.
    """

    def places(p: mi.Point3f, n: mi.Normal3f) -> np.ndarray:
        return np.hstack([to_numpy(p), radius * to_numpy(n)])

    count = min(neighbours, dr.width(points.p))
    tree = cKDTree(places(points.p, points.n))
    _, near = tree.query(places(gaussians.means, gaussians.normals), k=count)
    return to_numpy(points.target)[near.reshape(-1, count)].mean(axis=1)

"""Samples of the lit diffuse surfaces: points to supervise where no training view looks."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.errors import UserError
from gpf.progressive import pass_seed
from gpf.structs import Photons, VisiblePoints, take, to_numpy


def sample_surface_points(photons: Photons, count: int, radius: float, seed: int) -> VisiblePoints:
    """Positions of up to ``count`` photons of a photon map, half of them thinned out.

    One half is drawn from all photons alike, so that bright regions have many; the other with
    probabilities in inverse proportion to the number of photons in the same cell of a grid (twice
    ``radius`` wide, world units), which makes it nearly uniform over the lit area.
    """
    available = dr.width(photons.p)
    if available == 0:
        raise UserError(
            "scene", "no photon reached a diffuse surface", "Check where the emitters point."
        )
    cells = np.floor(to_numpy(photons.p) / (2 * radius)).astype(np.int64)
    cells -= cells.min(axis=0)
    key = np.ravel_multi_index(cells.T, cells.max(axis=0) + 1)
    _, cell, members = np.unique(key, return_inverse=True, return_counts=True)
    sparse = 1 / members[cell]
    rng = np.random.default_rng(pass_seed(seed, 0, stream=5))
    count = min(count, available)
    first = rng.choice(available, count // 2, replace=False)
    second = rng.choice(available, count - count // 2, replace=False, p=sparse / sparse.sum())
    chosen = take(photons, mi.UInt32(np.sort(np.concatenate([first, second])).astype(np.uint32)))
    return VisiblePoints(
        p=chosen.p,
        n=chosen.n,
        reflectance=mi.Color3f(1),
        throughput=mi.Color3f(1),
        emission=mi.Color3f(0),
        depth=mi.UInt32(0),
        valid=dr.full(mi.Bool, True, count),
    )

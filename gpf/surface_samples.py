"""Samples of the lit diffuse surfaces: points to supervise where no training view looks."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.density import PhotonDensity
from gpf.errors import UserError
from gpf.seeds import pass_seed
from gpf.structs import Photons, VisiblePoints, take


def sample_surface_points(
    photons: Photons, count: int, radius: float, bounds: tuple[Any, Any], seed: int
) -> VisiblePoints:
    """Positions of up to ``count`` photons of a photon map, half of them thinned out.

    One half is drawn from all photons alike, so that bright regions have many; the other with
    probabilities in inverse proportion to the density on their surface (within ``radius``, world
    units), which makes it nearly uniform over the lit area, and twice as dense along edges.
    """
    available = dr.width(photons.p)
    if available == 0:
        raise UserError(
            "scene", "no photon reached a diffuse surface", "Check where the emitters point."
        )
    alike = replace(photons, power=mi.Color3f(dr.full(mi.Float, 1, available)))
    density = PhotonDensity(alike, radius, bounds).irradiance(alike.p, alike.n)
    sparse = 1 / np.asarray(density.x.numpy(), dtype=np.float64)
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
        lit=mi.Bool(False),
    )

"""Samples of the surfaces: points to supervise also where no training view looks."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.errors import UserError
from gpf.progressive import pass_seed
from gpf.structs import Photons, VisiblePoints, concatenate, take, to_numpy
from gpf.thinning import count_in_cells


def sample_surface_points(
    photons: Photons,
    looks: VisiblePoints | Photons | None,
    count: int,
    radius: float,
    seed: int,
) -> VisiblePoints:
    """Up to ``count`` points on surfaces.

    One half are ``looks``, drawn at random: an outlook's visible points. (Without them, all photons
    alike.) The other half are positions of photons, drawn with probabilities in inverse proportion
    to the number of photons in the same cell of a grid (twice ``radius`` wide, world units), which
    makes them nearly uniform over the lit area.
    """
    p = to_numpy(photons.p)
    if len(p) == 0:
        raise UserError(
            "scene", "no photon reached a diffuse surface", "Check where the emitters point."
        )
    rng = np.random.default_rng(pass_seed(seed, 0, stream=5))
    (members,) = count_in_cells(p, 2 * radius, p)
    even = 1 / members

    def draw(
        source: Photons | VisiblePoints, wanted: int, chances: np.ndarray | None
    ) -> VisiblePoints:
        available = dr.width(source.p)
        rows = rng.choice(available, min(wanted, available), replace=False, p=chances)
        drawn = take(source, mi.UInt32(np.sort(rows).astype(np.uint32)))
        return VisiblePoints(
            p=drawn.p,
            n=drawn.n,
            reflectance=mi.Color3f(1),
            throughput=mi.Color3f(1),
            emission=mi.Color3f(0),
            depth=mi.UInt32(0),
            valid=dr.full(mi.Bool, True, len(rows)),
        )

    if looks is None:
        count, looks = min(count, len(p)), photons
    second = draw(photons, count - count // 2, even / even.sum())
    return concatenate([draw(looks, count // 2, None), second]) if count > 1 else second

"""Places for Gaussians where photons seldom come: joints, contact shadows, undersides of edges.

Photons say where there is light, and cameras see what has little of it, too. There the nearest
Gaussians of the surface may be far away, if it has any, and answer for light that is none of
theirs. Supervised points that have too few Gaussians around them become places for some.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.field import GaussianPhotonField
from gpf.structs import Photons
from gpf.thinning import oriented_places

# Gaussians of gaps are so far apart, in units of the search radius: a dozen in its disc.
SPACING = 0.5

# At most this share of a field's Gaussians goes into gaps.
MOST = 0.1


def find_gaps(
    field: GaussianPhotonField, position: np.ndarray, normal: np.ndarray, seed: int
) -> Photons:
    """Photons of no power at points whose search radius holds fewer than k Gaussians.

    One in each cell of a grid, and surfaces that face different ways have cells of their own.

    Parameters
    ----------
    field: what gaps are gaps of.
    position, normal: of points that the field is to know, world units and unit vectors, (P, 3).
    """
    p, n = (np.ascontiguousarray(a.T, dtype=np.float32) for a in (position, normal))
    _, reach = field.query(mi.Point3f(p), mi.Normal3f(n), dr.full(mi.Bool, True, len(position)))
    sparse = np.flatnonzero(reach.numpy() > 1)
    rng = np.random.default_rng(seed)
    rng.shuffle(sparse)
    width = SPACING * field.settings.search_radius
    cells = np.floor(oriented_places(position[sparse], normal[sparse], width) / width)
    _, first = np.unique(cells, axis=0, return_index=True)
    most = int(MOST * dr.width(field.gaussians.means))
    chosen = np.sort(sparse[np.sort(first)[:most]])
    return Photons(
        p=mi.Point3f(p[:, chosen]),
        n=mi.Normal3f(n[:, chosen]),
        power=dr.zeros(mi.Color3f, len(chosen)),
        depth=dr.zeros(mi.UInt32, len(chosen)),
    )

"""How noisy the light is that a source brings to what cameras see.

The power that arrives in the visible region does not tell: most of it may land on a few bright
places, and few photons in the dark. So the light is gathered at some visible points, from two
independent halves a and b of the paths, and compared relative to its level as in the loss of the
training: the mean of

    ω (a - b)²,    ω = 1 / (e² + ⟨e⟩²),    e = (a + b) / 2 as it is with all sources together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.spatial import cKDTree

from gpf.core.random import Stream, pass_seed
from gpf.core.spatial_hash import SpatialHash
from gpf.core.structs import VisiblePoints, from_numpy, to_numpy
from gpf.core.surface_tags import pack_tag, same_surface
from gpf.photons.emission import Source
from gpf.photons.tracing import PathSettings, record_photons
from gpf.scene.bounds import scene_bounds

POINTS = 4096
"""Visible points at which light is gathered."""

IN_DISC = 32
"""So many of them are around a typical one within the radius of the kernel."""

CLEARLY = 1.4
"""Rare bright photons make the comparison uncertain."""


def least_noisy(
    scene: mi.Scene,
    points: VisiblePoints,
    sources: Sequence[Source],
    settings: PathSettings,
    seed: int,
) -> int:
    """The place of the source whose light has the least noise at visible points; an earlier one if
    a later one is not better by the factor :data:`CLEARLY`.

    Parameters
    ----------
    points: in the visible region, (N,).
    settings: the paths that compare the sources, from each so many.
    """
    rng = np.random.default_rng(pass_seed(seed, 0, Stream.NOISE_POINTS))
    chosen = rng.integers(0, dr.width(points.p), POINTS)
    p, n = to_numpy(points.p)[chosen], to_numpy(points.n)[chosen]
    radius = float(np.median(cKDTree(p).query(p, IN_DISC)[0][:, -1]))
    at, facing = from_numpy(mi.Point3f, p), from_numpy(mi.Normal3f, n)
    bounds = scene_bounds(scene)
    half = replace(settings, paths=settings.paths // 2)

    def light(source: Source, number: int) -> np.ndarray:
        """The power that lands around each point, W, (POINTS,)."""
        part = replace(half, source=source)
        photons = record_photons(scene, part, pass_seed(seed, number, Stream.NOISE_PHOTONS))
        if dr.width(photons.p) == 0:
            return np.zeros(POINTS)
        tag, reach = pack_tag(photons.n), dr.opaque(mi.Float, radius)
        grid = SpatialHash(
            photons.p, cell=1.01 * radius, bounds=bounds, tag=tag, colour=photons.power
        )

        def add(total, index, record, distance2, inside):  # type: ignore[no-untyped-def]
            counts = inside & same_surface(record, at, facing, reach * reach)
            return total + dr.select(counts, record.colour, 0)

        return to_numpy(grid.visit(at, reach, add, mi.Color3f(0), mi.Bool(True))).mean(axis=1)

    found = np.array([[light(each, k) for k in range(2)] for each in sources])
    level = found.mean(axis=(0, 1))
    weight = 1 / (level**2 + level.mean() ** 2 + 1e-30)
    best, noise = 0, (weight * (found[:, 0] - found[:, 1]) ** 2).mean(axis=1)
    for number in range(1, len(sources)):
        if noise[number] * CLEARLY < noise[best]:
            best = number
    return best

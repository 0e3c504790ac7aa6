"""How noisy a source's light is on the surfaces that cameras see.

The power that arrives in the visible region does not show this: most of it may land on a few bright
places, and few photons in the dark. So light is gathered at some visible points from two
independent halves of the paths, a and b. The measure is their difference relative to the level of
the light, as in the training loss: the mean of

    ω (a - b)²,    ω = 1 / (e² + ⟨e⟩²),    e = (a + b) / 2 averaged over all sources.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.spatial import cKDTree

from gpf.core.random import Stream, pass_seed
from gpf.core.structs import VisiblePoints, from_numpy, to_numpy
from gpf.photons.density import PhotonDensity
from gpf.photons.emission import Source
from gpf.photons.tracing import PathSettings, record_photons
from gpf.scene.bounds import scene_bounds

POINTS = 4096
"""Visible points at which light is gathered."""

IN_DISC = 32
"""The kernel's radius is chosen so that it holds this many of the points around a typical one."""

CLEARLY = 1.4
"""Factor for a clear difference, because rare bright photons make the comparison uncertain."""


def least_noisy(
    scene: mi.Scene,
    points: VisiblePoints,
    sources: Sequence[Source],
    settings: PathSettings,
    seed: int,
) -> int:
    """Index of the source whose light has the least noise at visible points; to be chosen over an
    earlier source, a later one must be better by the factor :data:`CLEARLY`.

    Parameters
    ----------
    points: points in the visible region, (N,).
    settings: the paths that are traced from each source for the comparison.
    """
    rng = np.random.default_rng(pass_seed(seed, 0, Stream.NOISE_POINTS))
    chosen = rng.permutation(dr.width(points.p))[:POINTS]
    p, n = to_numpy(points.p)[chosen], to_numpy(points.n)[chosen]
    radius = float(np.median(cKDTree(p).query(p, [min(IN_DISC, len(p))])[0]))
    at, facing = from_numpy(mi.Point3f, p), from_numpy(mi.Normal3f, n)
    bounds = scene_bounds(scene)
    half = replace(settings, paths=settings.paths // 2)

    def light(source: Source, number: int) -> np.ndarray:
        """The irradiance of each point, (N,)."""
        part = replace(half, source=source)
        photons = record_photons(scene, part, pass_seed(seed, number, Stream.NOISE_PHOTONS))
        irradiance = PhotonDensity(photons, radius, bounds).irradiance(at, facing)
        return to_numpy(irradiance).mean(axis=1)

    found = np.array([[light(each, k) for k in range(2)] for each in sources])
    level = found.mean(axis=(0, 1))
    weight = 1 / (level**2 + level.mean() ** 2 + 1e-30)
    best, noise = 0, (weight * (found[:, 0] - found[:, 1]) ** 2).mean(axis=1)
    for number in range(1, len(sources)):
        if noise[number] * CLEARLY < noise[best]:
            best = number
    return best

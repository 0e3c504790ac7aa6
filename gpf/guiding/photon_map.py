"""Photon maps: the photons of many paths in the visible region."""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi

from gpf.core.random import Stream, pass_seed
from gpf.core.settings import AutoCount, Count, Seed, Settings
from gpf.core.structs import Photons, concatenate
from gpf.guiding.density_control import control_density
from gpf.guiding.visible_region import VisibleRegion
from gpf.photons.tracing import PathSettings, record_photons

# Number of paths traced and selected at a time, which bounds the memory.
BATCH = 100_000


class PhotonSettings(Settings):
    """The photons that become Gaussians.

    Attributes
    ----------
    paths: number of emitted paths; ``auto``: enough for 3 photons per Gaussian.
    rr_depth: number of interactions before Russian roulette.
    seed: seed of the paths.
    """

    paths: AutoCount = "auto"
    rr_depth: Count = 5
    seed: Seed = 2


def collect_photons(
    scene: mi.Scene, region: VisibleRegion | None, settings: PathSettings, seed: int
) -> Photons:
    """The photons in the region, after :func:`control_density`, or all if there is no region, (N,).

    Powers are divided by the number of all paths, so that sums over an area of the region are
    unbiased.
    """
    kept = []
    for number, first in enumerate(range(0, settings.paths, BATCH)):
        batch = replace(settings, paths=min(BATCH, settings.paths - first))
        photons = record_photons(scene, batch, pass_seed(seed, number, Stream.PHOTON_MAP))
        if dr.width(photons.p) > 0:
            photons.power *= batch.paths / settings.paths
        kept.append(photons if region is None else region.select(photons))
    photons = concatenate([photons for photons in kept if dr.width(photons.p) > 0] or kept[:1])
    dr.eval(photons)
    if region is None or dr.width(photons.p) == 0:
        return photons
    return control_density(photons, region.points, 4 * region.radius, seed)

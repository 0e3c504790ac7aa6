"""Photon maps: the photons of many paths, kept where a visible region needs them."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from gpf.core.random import pass_seed
from gpf.core.settings import AutoCount, Count, Seed, Settings
from gpf.core.structs import Photons, concatenate
from gpf.guiding.density_control import control_density
from gpf.guiding.visible_region import VisibleRegion
from gpf.photons.emission import Source, emit_light
from gpf.photons.tracing import record_photons

# Paths that are traced and filtered at a time: it bounds the memory of photons not kept.
BATCH = 100_000


class PhotonSettings(Settings):
    """The photons that become Gaussians; ``paths: auto``: enough for 3 of them per Gaussian."""

    paths: AutoCount = "auto"
    rr_depth: Count = 5
    seed: Seed = 2


def collect_photons(
    scene: mi.Scene,
    region: VisibleRegion | None,
    paths: int,
    seed: int,
    rr_depth: int = 5,
    source: Source = emit_light,
) -> Photons:
    """Photons of ``paths`` emitted paths that land on the visible region; without one, all: (N,).

    Where they are many and looks are few, they are thinned out (:func:`gpf.guiding.density_control.control_density`).

    Their powers are those of ``paths`` paths, so that sums over an area are unbiased whatever
    part of the scene the visible region leaves out.
    """
    kept = []
    for number, first in enumerate(range(0, paths, BATCH)):
        count = min(BATCH, paths - first)
        batch_seed = pass_seed(seed, number, stream=7)
        photons = record_photons(
            scene, paths=count, seed=batch_seed, rr_depth=rr_depth, source=source
        )
        photons.power *= count / paths
        kept.append(photons if region is None else region.select(photons))
    found = [photons for photons in kept if dr.width(photons.p) > 0] or kept[:1]
    photons = found[0] if len(found) == 1 else concatenate(found)
    dr.eval(photons)
    if region is None or dr.width(photons.p) == 0:
        return photons
    return control_density(photons, region.points, 4 * region.radius, seed)

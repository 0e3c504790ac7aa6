"""Photon maps: the photons of many paths, kept where an outlook needs them."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from gpf.emission import Source, emit_light
from gpf.outlook import Outlook
from gpf.photon_tracing import record_photons
from gpf.seeds import pass_seed
from gpf.structs import Photons, concatenate
from gpf.thinning import thin_photons

# Paths that are traced and filtered at a time: it bounds the memory of photons not kept.
BATCH = 100_000


def collect_photons(
    scene: mi.Scene,
    outlook: Outlook | None,
    paths: int,
    seed: int,
    rr_depth: int = 5,
    source: Source = emit_light,
) -> Photons:
    """Photons of ``paths`` emitted paths that land on the outlook; without one, all: (N,).

    Where they are many and looks are few, they are thinned out (:func:`gpf.thinning.thin_photons`).

    Their powers are those of ``paths`` paths, so that sums over an area are unbiased whatever
    part of the scene the outlook leaves out.
    """
    kept = []
    for number, first in enumerate(range(0, paths, BATCH)):
        count = min(BATCH, paths - first)
        batch_seed = pass_seed(seed, number, stream=7)
        photons = record_photons(
            scene, paths=count, seed=batch_seed, rr_depth=rr_depth, source=source
        )
        photons.power *= count / paths
        kept.append(photons if outlook is None else outlook.select(photons))
    found = [photons for photons in kept if dr.width(photons.p) > 0] or kept[:1]
    photons = found[0] if len(found) == 1 else concatenate(found)
    dr.eval(photons)
    if outlook is None or dr.width(photons.p) == 0:
        return photons
    return thin_photons(photons, outlook.points, 4 * outlook.radius, seed)

"""A pilot: photon paths that measure how much power reaches the visible region."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.structs import Photons
from gpf.guiding.visible_region import VisibleRegion
from gpf.photons.tracing import PathSettings, trace_photons


@dataclass(frozen=True)
class Pilot:
    """The contribution of each of N paths to the visible region.

    Attributes
    ----------
    power: sum over the photons of each path in the region, W, mean of the channels, (N,).
    photons: number of these photons, (N,).
    seed: seed of the paths.
    """

    power: np.ndarray
    photons: np.ndarray
    seed: int

    @property
    def arrived(self) -> int:
        """Number of paths with a photon in the region."""
        return int(np.count_nonzero(self.photons))

    @property
    def photons_per_path(self) -> float:
        """Mean number of photons of a path in the visible region."""
        return float(self.photons.mean())

    @property
    def efficiency(self) -> float:
        """(Σ Φ)² / (N Σ Φ²): this fraction of N paths, all of equal power, has the same noise."""
        total, square = self.power.sum(), (self.power**2).sum()
        return float(total**2 / (len(self.power) * square)) if square > 0 else 0.0


def trace_pilot(
    scene: mi.Scene, region: VisibleRegion | None, settings: PathSettings, seed: int
) -> Pilot:
    """Trace paths without storing photons. Without a visible region, photons count everywhere."""
    paths = settings.paths
    power, photons = dr.zeros(mi.Float, paths), dr.zeros(mi.UInt32, paths)
    lane = dr.arange(mi.UInt32, paths)

    def deposit(found: Photons, diffused: mi.Bool, active: mi.Bool) -> None:
        if region is not None:
            active = active & region.contains(found.p, found.n, active)
        # Each path has its own sums.
        for total, more in ((power, dr.sum(found.power) / 3), (photons, mi.UInt32(1))):
            dr.scatter_add(total, more, lane, active, dr.ReduceMode.NoConflicts)

    trace_photons(scene, deposit, settings, seed)
    return Pilot(
        power=np.asarray(power.numpy(), dtype=np.float64),
        photons=np.asarray(photons.numpy(), dtype=np.int64),
        seed=seed,
    )

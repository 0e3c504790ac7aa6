"""The emission plan of a scene: where photons are needed, how they are emitted, and how many."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

import mitsuba as mi
from pydantic import Field

from gpf.core.random import Stream, pass_seed
from gpf.core.settings import Seed, Settings
from gpf.core.structs import Photons
from gpf.guiding.guided_emission import EmissionGuide
from gpf.guiding.photon_map import BATCH, collect_photons
from gpf.guiding.pilot import Pilot, trace_pilot
from gpf.guiding.visible_region import VisibleRegion
from gpf.photons.emission import Source, emit_light
from gpf.photons.tracing import PathSettings

# Emission is guided where fewer than this share of the paths would do if all were of use, and if
# a guide makes that share so many times larger.
GUIDED_BELOW = 0.3
LEAST_GAIN = 1.2

PHOTONS_PER_GAUSSIAN = 3

log = logging.getLogger(__name__)


class VisibleRegionSettings(Settings):
    """Where photons and supervision are needed, and whether emission is guided there.

    Attributes
    ----------
    use: whether they are needed in the visible region alone; else everywhere.
    rays: that look for the visible region.
    guide: whether emission is guided where most photons would miss the region.
    pilot_paths: photon paths that measure how many do.
    """

    use: bool = True
    rays: Annotated[int, Field(ge=1000)] = 524_288
    guide: bool = True
    pilot_paths: Annotated[int, Field(ge=1000)] = 1_048_576
    seed: Seed = 5


@dataclass(frozen=True)
class EmissionPlan:
    """Where photons are needed, how they are emitted, and what a path then brings there.

    Attributes
    ----------
    region: where photons are needed; None: everywhere.
    source: of the photons.
    pilot: of paths from that source.
    """

    region: VisibleRegion | None
    source: Source
    pilot: Pilot

    @classmethod
    def make(
        cls,
        scene: mi.Scene,
        sensors: Sequence[mi.Sensor],
        settings: VisibleRegionSettings,
        rr_depth: int = 5,
    ) -> EmissionPlan:
        """Find the region that can be seen from where the sensors look, and guide the emission
        there if that pays.

        The plan depends on the number of pixels of the sensors: give them one size, whatever the
        size of the images is to be.
        """
        region = None
        if settings.use:
            region = VisibleRegion(scene, sensors, settings.seed, settings.rays)
        seed = pass_seed(settings.seed, 0, Stream.PILOT)
        paths = PathSettings(settings.pilot_paths, rr_depth=rr_depth)
        pilot = trace_pilot(scene, region, paths, seed)
        if not settings.guide or pilot.efficiency >= GUIDED_BELOW:
            return cls(region, emit_light, pilot)
        guide = EmissionGuide.learn(scene, pilot)
        seed = pass_seed(settings.seed, 1, Stream.PILOT)
        guided = trace_pilot(scene, region, replace(paths, source=guide.emit), seed)
        if guided.efficiency < LEAST_GAIN * pilot.efficiency:
            return cls(region, emit_light, pilot)
        return cls(region, guide.emit, guided)

    def collect(self, scene: mi.Scene, paths: int, seed: int, rr_depth: int = 5) -> Photons:
        """Photons in the visible region, of so many paths, (N,)."""
        settings = PathSettings(paths, rr_depth=rr_depth, source=self.source)
        return collect_photons(scene, self.region, settings, seed)

    def paths_for_gaussians(self, gaussians: int) -> int:
        """How many paths leave enough photons in the region to choose so many Gaussians from:
        whole batches, 1 to 50."""
        photons = PHOTONS_PER_GAUSSIAN * gaussians
        return _batches(photons / max(self.pilot.photons_per_path, 1e-9), most=50)

    def paths_for_passes(self, equal_paths: int) -> int:
        """How many paths bring as much, and as noisily, as ``equal_paths`` that are all alike.

        Whole batches, 1 to 5 of them: passes with more are slow, and there are many passes.
        """
        return _batches(equal_paths / max(self.pilot.efficiency, 1e-9), most=5)

    def facts(self) -> dict[str, Any]:
        """What a record of a computation says about the plan."""
        return {
            "photons_in_region_per_path": self.pilot.photons_per_path,
            "path_efficiency": self.pilot.efficiency,
            "emission_guided": self.source is not emit_light,
        }


def _batches(paths: float, most: int) -> int:
    wanted = max(round(paths / BATCH), 1)
    if wanted > most:
        log.warning(
            "%s photon paths would be needed; auto takes at most %s. Give a number to have more.",
            f"{wanted * BATCH:,}",
            f"{most * BATCH:,}",
        )
    return BATCH * min(wanted, most)

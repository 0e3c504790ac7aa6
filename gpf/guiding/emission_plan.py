"""The emission plan of a scene: its visible region, its emission, and numbers of paths."""

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

# Emission is guided if the efficiency of the paths is below GUIDED_BELOW, and if guiding improves
# it by the factor LEAST_GAIN.
GUIDED_BELOW = 0.3
LEAST_GAIN = 1.2

# Each of so many guides learns from the paths of the one before.
GUIDES = 2

PHOTONS_PER_GAUSSIAN = 3

log = logging.getLogger(__name__)


class VisibleRegionSettings(Settings):
    """The visible region, and guided emission towards it.

    Attributes
    ----------
    use: whether Gaussians and targets are restricted to the visible region; else everywhere.
    rays: number of rays that sample the visible region.
    guide: whether emission may be guided, if most photons miss the region.
    pilot_paths: number of photon paths that measure how many miss it.
    seed: of the rays and the pilot paths.
    """

    use: bool = True
    rays: Annotated[int, Field(ge=1000)] = 524_288
    guide: bool = True
    pilot_paths: Annotated[int, Field(ge=1000)] = 1_048_576
    seed: Seed = 5


@dataclass(frozen=True)
class EmissionPlan:
    """The region where photons are needed, their emission, and the yield of a path.

    Attributes
    ----------
    region: where photons are needed; None means everywhere.
    source: emits the photons.
    pilot: measurement of paths from that source.
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
        """Sample the visible region of the sensors, and guide the emission if that is efficient.

        The plan depends on the number of pixels of the sensors: use sensors of a fixed size, not of
        the size of the images.
        """
        region = None
        if settings.use:
            region = VisibleRegion(scene, sensors, settings.seed, settings.rays)
        seed = pass_seed(settings.seed, 0, Stream.PILOT)
        paths = PathSettings(settings.pilot_paths, rr_depth=rr_depth)
        pilot = trace_pilot(scene, region, paths, seed)
        if not settings.guide or pilot.efficiency >= GUIDED_BELOW:
            return cls(region, emit_light, pilot)
        guide: EmissionGuide | None = None
        source, guided = emit_light, pilot
        for number in range(1, GUIDES + 1):
            guide = EmissionGuide.learn(scene, guided, guide)
            source = guide.emit
            seed = pass_seed(settings.seed, number, Stream.PILOT)
            guided = trace_pilot(scene, region, replace(paths, source=source), seed)
        if guided.efficiency < LEAST_GAIN * pilot.efficiency:
            return cls(region, emit_light, pilot)
        return cls(region, source, guided)

    def collect(self, scene: mi.Scene, paths: int, seed: int, rr_depth: int = 5) -> Photons:
        """The photons of so many paths in the visible region, (N,); see :func:`collect_photons`."""
        settings = PathSettings(paths, rr_depth=rr_depth, source=self.source)
        return collect_photons(scene, self.region, settings, seed)

    def paths_for_gaussians(self, gaussians: int) -> int:
        """The number of paths with enough photons in the region for so many Gaussians.

        There are :data:`PHOTONS_PER_GAUSSIAN` photons per Gaussian; 1 to 50 whole batches of paths.
        """
        photons = PHOTONS_PER_GAUSSIAN * gaussians
        return _batches(photons / max(self.pilot.photons_per_path, 1e-9), most=50)

    def paths_for_passes(self, equal_paths: int) -> int:
        """The number of paths with the same noise as ``equal_paths`` paths of equal contribution.

        1 to 5 whole batches of paths, because longer passes are slow and there are many passes.
        """
        return _batches(equal_paths / max(self.pilot.efficiency, 1e-9), most=5)

    def facts(self) -> dict[str, Any]:
        """The plan's numbers for the record of a computation, JSON values."""
        return {
            "photons_in_region_per_path": self.pilot.photons_per_path,
            "path_efficiency": self.pilot.efficiency,
            "emission_guided": self.source is not emit_light,
        }


def _batches(paths: float, most: int) -> int:
    """``paths`` as whole batches, at least 1 and at most ``most`` of them."""
    wanted = max(round(paths / BATCH), 1)
    if wanted > most:
        log.warning(
            "%s photon paths would be needed; auto takes at most %s. Give a number to have more.",
            f"{wanted * BATCH:,}",
            f"{most * BATCH:,}",
        )
    return BATCH * min(wanted, most)

"""The emission plan of a scene: its visible region, its emission, and numbers of paths."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

import mitsuba as mi
from pydantic import Field

from gpf.camera.next_event import samples_every_emitter
from gpf.core.random import Stream, pass_seed
from gpf.core.settings import Seed, Settings
from gpf.core.structs import Photons
from gpf.guiding.arriving_noise import least_noisy
from gpf.guiding.guided_emission import EmissionGuide
from gpf.guiding.photon_map import BATCH, collect_photons
from gpf.guiding.pilot import Pilot, trace_pilot
from gpf.guiding.visible_region import VisibleRegion
from gpf.photons.emission import Source, emit_light
from gpf.photons.tracing import PathSettings

# Emission may be guided if the efficiency of the paths is below this.
GUIDED_BELOW = 0.3

# Each guide learns from the paths of the one before; the first that is not better by the factor
# LEAST_GAIN is the last.
MOST_GUIDES, LEAST_GAIN = 6, 1.2

# If fewer than FEW paths reach the region, pilots have MORE times as many paths.
FEW, MORE = 4000, 4

PHOTONS_PER_GAUSSIAN = 3

KEPT = 0.5
"""A source serves another frame if its paths are not less efficient there, by this factor."""

log = logging.getLogger(__name__)


class VisibleRegionSettings(Settings):
    """The visible region, and guided emission towards it.

    Attributes
    ----------
    use: whether Gaussians and targets are restricted to the visible region or lie everywhere.
    rays: number of rays that sample the visible region.
    guide: whether emission may be guided when most photons miss the region.
    pilot_paths: number of photon paths traced to measure how many miss it.
    seed: seed of the rays and the pilot paths.
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
    paths: of the pilot, with the source of the photons.
    pilot: measurement of these paths.
    """

    region: VisibleRegion | None
    paths: PathSettings
    pilot: Pilot

    @property
    def source(self) -> Source:
        """Emits the photons."""
        return self.paths.source

    @classmethod
    def make(
        cls,
        scene: mi.Scene,
        sensors: Sequence[mi.Sensor],
        settings: VisibleRegionSettings,
        rr_depth: int = 5,
        direct: Literal["photons", "emitters"] = "emitters",
    ) -> EmissionPlan:
        """Sample the visible region of the sensors, and guide the emission if that lowers the
        noise there.

        The plan depends on the number of pixels of the sensors: use sensors of a fixed size, not
        the size of the images.

        Parameters
        ----------
        direct: source of direct light, as in :class:`gpf.sppm.passes.PassSettings`. If it is
            ``emitters``, a guide may serve only the other photons.
        """
        region = _region(scene, sensors, settings)
        paths = PathSettings(settings.pilot_paths, rr_depth=rr_depth)
        seed = pass_seed(settings.seed, 0, Stream.PILOT)
        pilot = trace_pilot(scene, region, paths, seed)
        if not settings.guide or pilot.efficiency >= GUIDED_BELOW:
            return cls(region, paths, pilot)
        found = [(paths, pilot), _guide(scene, region, paths, pilot, settings.seed)]
        if region is None:
            return cls(region, *max(found, key=lambda each: each[1].efficiency))
        if direct == "emitters" and samples_every_emitter(scene):
            paths = replace(paths, indirect=True)
            pilot = trace_pilot(scene, region, paths, seed)
            if pilot.arrived < FEW:
                paths = replace(paths, paths=MORE * paths.paths)
                pilot = trace_pilot(scene, region, paths, seed)
            found.append(_guide(scene, region, paths, pilot, settings.seed))
        sources = [each.source for each, _ in found]
        return cls(region, *found[least_noisy(scene, region.points, sources, paths, seed)])

    def again(
        self, scene: mi.Scene, sensors: Sequence[mi.Sensor], settings: VisibleRegionSettings
    ) -> EmissionPlan | None:
        """The same source for another frame of an animation, which takes a tenth of the time; None
        if it is less efficient there, by the factor :data:`KEPT`.

        Another source would make other photons, which let the light flicker.
        """
        region = _region(scene, sensors, settings)
        pilot = trace_pilot(scene, region, self.paths, pass_seed(settings.seed, 0, Stream.PILOT))
        if pilot.efficiency < KEPT * self.pilot.efficiency:
            return None
        return EmissionPlan(region, self.paths, pilot)

    def collect(self, scene: mi.Scene, paths: int, seed: int, rr_depth: int = 5) -> Photons:
        """The photons of ``paths`` paths in the visible region, (N,): :func:`collect_photons`."""
        settings = PathSettings(paths, rr_depth=rr_depth, source=self.source)
        return collect_photons(scene, self.region, settings, seed)

    def paths_for_gaussians(self, gaussians: int) -> int:
        """The number of paths that bring enough photons into the region for this many Gaussians.

        :data:`PHOTONS_PER_GAUSSIAN` photons per Gaussian; 1 to 50 whole batches of paths.
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


def _region(
    scene: mi.Scene, sensors: Sequence[mi.Sensor], settings: VisibleRegionSettings
) -> VisibleRegion | None:
    if not settings.use:
        return None
    return VisibleRegion(scene, sensors, settings.seed, settings.rays)


def _guide(
    scene: mi.Scene, region: VisibleRegion | None, paths: PathSettings, pilot: Pilot, seed: int
) -> tuple[PathSettings, Pilot]:
    """Paths from a guided source that has learnt from a pilot of these paths, and their pilot."""
    guide = None
    for number in range(1, MOST_GUIDES + 1):
        guide = EmissionGuide.learn(scene, pilot, guide)
        before = pilot.efficiency
        paths = replace(paths, source=guide.emit)
        pilot = trace_pilot(scene, region, paths, pass_seed(seed, number, Stream.PILOT))
        if number > 1 and pilot.efficiency < LEAST_GAIN * before:
            break
    return paths, pilot


def _batches(paths: float, most: int) -> int:
    """``paths`` as whole batches, at least 1 and at most ``most`` of them."""
    wanted = max(round(paths / BATCH), 1)
    if wanted > most:
        log.warning(
            "%s photon paths would be needed; auto takes at most %s. Set a number to use more.",
            f"{wanted * BATCH:,}",
            f"{most * BATCH:,}",
        )
    return BATCH * min(wanted, most)

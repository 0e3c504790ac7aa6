"""What the stages `reference` and `photons` share: where photons are needed, and how many."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from gpf.emission import Source, emit_light
from gpf.emission_guiding import EmissionGuide
from gpf.outlook import Outlook
from gpf.photon_map import BATCH
from gpf.pilot import Pilot, trace_pilot
from gpf.seeds import pass_seed
from gpf.sensors import make_sensor
from stages.progress import say
from stages.workspace import Workspace

# Emission is guided where fewer than this share of the paths would do if all were of use, and if
# a guide makes that share so many times larger.
GUIDED_BELOW = 0.3
LEAST_GAIN = 1.2

PHOTONS_PER_GAUSSIAN = 3


@dataclass(frozen=True)
class Lookout:
    """Where photons are needed, how they are emitted, and what a path then brings there.

    Attributes
    ----------
    outlook: None where params.yaml does without: photons are needed everywhere.
    source: of the photons.
    pilot: of paths from that source.
    """

    outlook: Outlook | None
    source: Source
    pilot: Pilot

    @classmethod
    def open(cls, work: Workspace, scene: Any) -> Lookout:
        """Look around from the training views, and guide the emission where that pays."""
        section = work.params.outlook
        outlook = None
        if section.use:
            # Of one size whatever params.yaml says: photons do not depend on the film.
            sensors = [make_sensor(view, *work.views.size(256)) for view in work.views.train]
            outlook = Outlook(scene, sensors, section.seed, section.rays)
        seed = pass_seed(section.seed, 0, stream=8)
        pilot = trace_pilot(scene, outlook, seed, section.pilot_paths)
        if not section.guide or pilot.efficiency >= GUIDED_BELOW:
            return cls(outlook, emit_light, pilot)
        guide = EmissionGuide.learn(scene, pilot)
        seed = pass_seed(section.seed, 1, stream=8)
        guided = trace_pilot(scene, outlook, seed, section.pilot_paths, guide.emit)
        if guided.efficiency < LEAST_GAIN * pilot.efficiency:
            return cls(outlook, emit_light, pilot)
        return cls(outlook, guide.emit, guided)

    def paths_for_gaussians(self, gaussians: int) -> int:
        """How many paths leave enough photons in the outlook for so many to be chosen from them:
        whole batches, 1 to 50 of them."""
        photons = PHOTONS_PER_GAUSSIAN * gaussians
        return _batches(photons / max(self.pilot.photons_per_path, 1e-9), most=50)

    def paths_for_passes(self, equal_paths: int) -> int:
        """How many paths bring as much, and as noisily, as ``equal_paths`` that are all alike.

        Whole batches, 1 to 5 of them: passes with more are slow, and there are many passes.
        """
        return _batches(equal_paths / max(self.pilot.efficiency, 1e-9), most=5)

    def facts(self) -> dict[str, Any]:
        """For the stage's record."""
        return {
            "photons_in_outlook_per_path": self.pilot.photons_per_path,
            "path_efficiency": self.pilot.efficiency,
            "emission_guided": self.source is not emit_light,
        }


def _batches(paths: float, most: int) -> int:
    wanted = max(round(paths / BATCH), 1)
    if wanted > most:
        say(
            f"auto: {wanted * BATCH:,} photon paths would be needed, {most * BATCH:,} are taken; "
            "params.yaml can ask for more"
        )
    return BATCH * min(wanted, most)

"""Settings of the references and of the training targets."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal

import mitsuba as mi
import numpy as np
from pydantic import Field

from gpf.core.random import Stream, pass_seed
from gpf.core.settings import AutoCount, Count, Length, NotNegative, Seed
from gpf.guiding.emission_plan import EmissionPlan
from gpf.guiding.visible_region import by_sensor, sample_visible_points
from gpf.photons.tracing import PathSettings
from gpf.sppm.passes import PassSettings, propose_radius

# With `photons_per_pass: auto`, a pass is as good as this many photon paths of equal power.
EQUAL_PATHS = 50_000

# With `initial_radius: auto`, the radius is measured at this many points that the views see.
RADIUS_POINTS = 65_536


class ReferenceSettings(PassSettings):
    """Settings of the references and of the training targets.

    Attributes
    ----------
    passes: maximum number of passes.
    photons_per_pass: emitted paths; ``auto``: depends on what they contribute to the visible
        region.
    initial_radius: world units; ``auto``: from the photon density where the views look.
    view_points, surface_points: maximum number of supervised points seen by training views, and of
        supervised surface samples.
    images: number of training views with images; ``auto``: as many as the systems to be run need.
    target_psnr: dB; stop when a second reference is expected to agree this well; 0: never.
    """

    passes: Annotated[int, Field(ge=4)] = 250
    photons_per_pass: AutoCount = "auto"  # type: ignore[assignment]
    initial_radius: Length = "auto"  # type: ignore[assignment]
    max_depth: Literal[-1] = -1  # fields and targets hold light after any number of bounces
    view_points: Count = 200_000
    surface_points: Annotated[int, Field(ge=0)] = 300_000
    images: Annotated[int, Field(ge=0)] | Literal["auto"] = "auto"
    seed: Seed = 1
    target_psnr: NotNegative = 0.0

    def measure(
        self, scene: mi.Scene, sensors: Sequence[mi.Sensor], plan: EmissionPlan
    ) -> PassSettings:
        """Settings of the passes, with measured values in place of ``auto``: the number of paths
        depends on what they contribute to the visible region, the radius on the points that all
        sensors see.
        """
        paths, radius = self.photons_per_pass, self.initial_radius
        if paths == "auto":
            paths = plan.paths_for_passes(EQUAL_PATHS)
        if radius == "auto":
            each, seed = (
                max(1, RADIUS_POINTS // len(sensors)),
                pass_seed(self.seed, 0, Stream.CAMERA),
            )
            points = sample_visible_points(scene, sensors, each, seed, 0)
            seen = by_sensor(points, len(sensors))
            pilot = PathSettings(paths, rr_depth=self.rr_depth, source=plan.source)
            measured = propose_radius(scene, seen, pilot, self.seed)
            # Rounded in steps of a fifth, so that a new training view rarely changes the radius:
            # with a different radius, all novel views would have to be rendered again.
            radius = float(f"{2 ** (round(4 * np.log2(measured)) / 4):.4g}")
        common = {name: getattr(self, name) for name in PassSettings.model_fields}
        return PassSettings(**common | {"photons_per_pass": paths, "initial_radius": radius})

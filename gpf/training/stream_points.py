"""The points at which a stream learns the light."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import mitsuba as mi
import numpy as np

from gpf.core.random import Stream, pass_seed
from gpf.core.structs import Photons, VisiblePoints
from gpf.guiding.emission_plan import EmissionPlan
from gpf.guiding.visible_region import by_sensor, sample_visible_points
from gpf.sppm.passes import PassSettings
from gpf.training.streaming import StreamSettings
from gpf.training.surface_points import surface_points
from gpf.training.targets import SURFACES


def stream_points(
    scene: mi.Scene,
    sensors: Mapping[str, mi.Sensor],
    plan: EmissionPlan,
    passes: PassSettings,
    settings: StreamSettings,
    photons: Photons,
    wanted: Literal["views", "surface", "both"] = "both",
) -> dict[str, VisiblePoints]:
    """The supervised points of a stream by name: of each view, and of surfaces under the name
    :data:`gpf.training.targets.SURFACES`.

    Parameters
    ----------
    sensors: the views, by name.
    plan: where photons are needed.
    photons: points on surfaces are chosen among these and among visible points.
    wanted: points of views, samples of surfaces, or both.
    """
    found: dict[str, VisiblePoints] = {}
    if wanted != "surface" and sensors:
        views = list(sensors.values())
        pixels = sum(int(np.prod(view.film().crop_size())) for view in views)
        each = max(min(pixels, settings.view_points) // len(views), 1)
        seed = pass_seed(settings.seed, 0, Stream.VIEW_POINTS)
        seen = by_sensor(sample_visible_points(scene, views, each, seed, 0), len(views))
        found |= dict(zip(sensors, seen, strict=True))
    if wanted != "views":
        count = settings.surface_points
        found[SURFACES] = surface_points(scene, plan, passes, count, settings.seed, photons)
    return found

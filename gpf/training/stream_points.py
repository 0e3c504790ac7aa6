"""The points at which a stream learns the light."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import mitsuba as mi
import numpy as np

from gpf.core.structs import Photons, VisiblePoints
from gpf.guiding.emission_plan import EmissionPlan
from gpf.sppm.passes import PassSettings
from gpf.training.streaming import StreamSettings
from gpf.training.surface_points import share_of_pixels, target_points


def stream_points(
    scene: mi.Scene,
    sensors: Mapping[str, mi.Sensor],
    plan: EmissionPlan,
    passes: PassSettings,
    settings: StreamSettings,
    photons: Photons,
    wanted: Literal["views", "surface", "both"] = "both",
) -> dict[str, VisiblePoints]:
    """The supervised points of a stream; parameters as for
    :func:`gpf.training.surface_points.target_points`.

    ``wanted``: points of views, samples of surfaces, or both.
    """
    pixels = sum(int(np.prod(sensor.film().crop_size())) for sensor in sensors.values())
    return target_points(
        scene,
        {} if wanted == "surface" else sensors,
        plan,
        passes,
        share_of_pixels(settings.view_points, pixels),
        0 if wanted == "views" else settings.surface_points,
        settings.seed,
        photons,
    )

"""The camera samples of a reference view, and its visible points that are supervised."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.camera.film import FilmSamples, sample_film
from gpf.core.random import pass_seed, stream_of
from gpf.core.structs import VisiblePoints, from_numpy
from gpf.scene.lamps import Lamps
from gpf.sppm.passes import PassSettings


def sample_view(
    scene: mi.Scene, sensor: mi.Sensor, name: str, settings: PassSettings, seed: int, t: int
) -> FilmSamples:
    """One sample per pixel of a view; each pass ``t`` has different samples."""
    return sample_film(
        scene,
        sensor,
        pass_seed(seed, t, stream_of(name)),
        settings.max_depth,
        settings.rr_depth,
        lamps=Lamps(scene) if settings.direct == "emitters" else None,
        walks=settings.glossy_walks,
    )


def fixed_points(
    scene: mi.Scene,
    sensor: mi.Sensor,
    name: str,
    settings: PassSettings,
    seed: int,
    share: float = 1.0,
) -> VisiblePoints:
    """One visible point per pixel, the same for all passes, (W H,).

    Only a random ``share`` of the pixels have a valid point.
    """
    # Direct light at these points is sampled in each pass, not here.
    whole = settings.model_copy(update={"direct": "photons", "glossy_walks": 1})
    points = sample_view(scene, sensor, name, whole, seed, t=0).points
    if share < 1:
        rng = np.random.default_rng(pass_seed(seed, 1, stream_of(name)))
        points.valid &= from_numpy(mi.Bool, rng.random(dr.width(points.p)) < share)
    return points

"""Fits that take seconds."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from gpf.field.field import GaussianPhotonField
from gpf.fitting import opening, plan
from gpf.fitting.progress import FitProgress
from gpf.guiding.emission_plan import BATCH, VisibleRegionSettings
from gpf.scene.sensors import make_sensor
from gpf.scene.views import View
from gpf.training.streaming import StreamSettings

VIEWS = [
    View(name="front", origin=(0, 0, 3.9), target=(0, 0, 0), fov=39.3),
    View(name="left", origin=(-0.5, 0.2, 2.5), target=(0.1, -0.3, 0), fov=45),
]


def make_small(monkeypatch: pytest.MonkeyPatch, passes: int, steps: int, paths: int) -> None:
    """Let `gpf.fit` use few photons, points and steps.

    Parameters
    ----------
    passes: until the first complete field.
    paths: of a pilot that measures how many photons a pass needs.
    """
    region = VisibleRegionSettings(rays=20_000, pilot_paths=20_000)
    stream = StreamSettings(view_points=2000, surface_points=10_000)
    monkeypatch.setattr(opening, "REGION", region)
    for module in ("fit", "frames"):
        monkeypatch.setattr(f"gpf.fitting.{module}.STREAM", stream)
    monkeypatch.setattr(plan, "FIRST_PASSES", passes)
    monkeypatch.setattr(plan, "MOST_STEPS", steps)
    monkeypatch.setattr(plan, "LEAST_STEPS", steps)
    monkeypatch.setattr("gpf.sppm.reference.EQUAL_PATHS", paths)
    monkeypatch.setattr("gpf.guiding.emission_plan.BATCH", min(5 * paths, BATCH))


def sensors(rows: int = 32) -> list[mi.Sensor]:
    return [make_sensor(view, rows, rows) for view in VIEWS]


class Clock:
    """Seconds that only passes and steps let go by."""

    def __init__(self) -> None:
        self.now, self.before = 0.0, (0, 0)

    def perf_counter(self) -> float:
        return self.now

    def count(self, progress: FitProgress) -> None:
        """A pass takes .2 s, a step of the optimiser .02 s."""
        passes, steps = self.before
        self.now += 0.2 * (progress.passes > passes) + 0.02 * (progress.steps != steps)
        self.before = progress.passes, progress.steps


def assert_same_gaussians(field: GaussianPhotonField, expected: GaussianPhotonField) -> None:
    """Bit for bit."""
    for name, values in vars(expected.gaussians).items():
        np.testing.assert_array_equal(vars(field.gaussians)[name].numpy(), values.numpy())

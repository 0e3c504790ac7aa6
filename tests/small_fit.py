"""Fits that take seconds."""

from __future__ import annotations

import pytest

from gpf.fitting import fit as fitting
from gpf.fitting import plan
from gpf.guiding.emission_plan import BATCH, VisibleRegionSettings
from gpf.training.streaming import StreamSettings


def make_small(monkeypatch: pytest.MonkeyPatch, passes: int, steps: int, paths: int) -> None:
    """Let `gpf.fit` use few photons, points and steps.

    Parameters
    ----------
    passes: until the first complete field.
    paths: of a pilot that measures how many photons a pass needs.
    """
    small = {
        "REGION": VisibleRegionSettings(rays=20_000, pilot_paths=20_000),
        "STREAM": StreamSettings(view_points=2000, surface_points=10_000),
    }
    for name, value in small.items():
        monkeypatch.setattr(fitting, name, value)
    monkeypatch.setattr(plan, "FIRST_PASSES", passes)
    monkeypatch.setattr(plan, "MOST_STEPS", steps)
    monkeypatch.setattr(plan, "LEAST_STEPS", steps)
    monkeypatch.setattr("gpf.sppm.reference.EQUAL_PATHS", paths)
    monkeypatch.setattr("gpf.guiding.emission_plan.BATCH", min(5 * paths, BATCH))

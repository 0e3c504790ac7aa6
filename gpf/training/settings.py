"""How a field is fitted."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field

from gpf.core.settings import Count, NotNegative, Positive, Seed, Settings, Share


class LearningRates(Settings):
    """Adam's step sizes.

    Means are in units of the search radius, irradiance in units of the mean target around the
    Gaussian; log scales and quaternions have no unit.
    """

    means: NotNegative = 8e-3
    log_scales: NotNegative = 2e-2
    quats: NotNegative = 2e-2
    irradiance: NotNegative = 8e-2


class TrainingSettings(Settings):
    """How a field is fitted.

    Attributes
    ----------
    steps: optimiser steps.
    batch: supervised points per step.
    points: the supervised points: those that ``views`` see, samples of the ``surface``, or both.
    supervision: targets from a finished ``reference``, or ``streaming``: while passes come in.
    loss: ``squared``, or ``relative`` to the square of target and mean: what is dark counts too.
    rates: initial learning rates; they decay to ``final_rate`` times that on a cosine.
    rebuild_every: at most so many steps between rebuilds of the neighbour lists; evaluations
        rebuild them as well.
    evaluate_every: steps between evaluations on the held-out points.
    held_out: share of the points that training does not see; the state with the smallest error
        there is kept.
    seed: of the split and the batches.
    checkpoint_seconds: between checkpoints.
    """

    steps: Count = 500
    batch: Count = 32_768
    points: Literal["views", "surface", "both"] = "both"
    supervision: Literal["reference", "streaming"] = "reference"
    loss: Literal["squared", "relative"] = "relative"
    rates: LearningRates = LearningRates()
    final_rate: Annotated[float, Field(gt=0, le=1)] = 0.1
    rebuild_every: Count = 100
    evaluate_every: Count = 50
    held_out: Share = 0.1
    seed: Seed = 3
    checkpoint_seconds: Positive = 30.0


def cosine_decay(done: float, final: float) -> float:
    """A cosine from 1 to ``final`` while ``done`` goes from 0 to 1."""
    return final + (1 - final) * 0.5 * (1 + math.cos(math.pi * min(done, 1.0)))

"""Settings of the training."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field

from gpf.core.settings import Count, NotNegative, Seed, Settings, Share
from gpf.training.loss import Loss


class LearningRates(Settings):
    """Adam's learning rates: of means in search radii, of irradiance in units of the mean target
    around the Gaussian, of log scales and quaternions without unit."""

    means: NotNegative = 8e-3
    log_scales: NotNegative = 2e-2
    quats: NotNegative = 2e-2
    irradiance: NotNegative = 8e-2


class TrainingSettings(Settings):
    """Settings of the training.

    Attributes
    ----------
    steps: optimiser steps.
    batch: supervised points per step.
    points: which points are supervised: visible points of ``views``, samples of the ``surface``, or
        both.
    loss: ``squared``, or ``relative`` to the light at each point (:mod:`gpf.training.loss`).
    rates: initial learning rates; they fall on a cosine to ``final_rate`` times these values.
    rebuild_every: largest number of steps between rebuilds of the neighbour lists; an evaluation
        rebuilds them too.
    evaluate_every: steps between evaluations on the held-out points.
    held_out: share of the points that training does not use; the state with the smallest error at
        these points is kept.
    seed: for the split into training and held-out points, and for the batches.
    """

    steps: Count = 500
    batch: Count = 32_768
    points: Literal["views", "surface", "both"] = "both"
    loss: Loss = "relative"
    rates: LearningRates = LearningRates()
    final_rate: Annotated[float, Field(gt=0, le=1)] = 0.1
    rebuild_every: Count = 100
    evaluate_every: Count = 50
    held_out: Share = 0.1
    seed: Seed = 3


def cosine_decay(done: float, final: float) -> float:
    """Falls from 1 to ``final`` on a cosine while ``done`` goes from 0 to 1."""
    return final + (1 - final) * 0.5 * (1 + math.cos(math.pi * min(done, 1.0)))

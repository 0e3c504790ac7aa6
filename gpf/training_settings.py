"""How the field is fitted: what `gpf.training` can be told."""

from __future__ import annotations

import math
from dataclasses import dataclass, field


@dataclass(frozen=True)
class LearningRates:
    """Adam's step sizes. Means are in units of the search radius, irradiance in units of the mean
    target around the Gaussian; log scales and quaternions have none."""

    means: float = 8e-3
    log_scales: float = 2e-2
    quats: float = 2e-2
    irradiance: float = 8e-2


@dataclass(frozen=True)
class TrainingSettings:
    """How the field is fitted.

    Attributes
    ----------
    steps: optimiser steps.
    batch: supervised points per step.
    rates: initial learning rates; they decay to ``final_rate`` times that on a cosine.
    rebuild_every: at most so many steps between rebuilds of the neighbour lists; evaluations
        rebuild them as well.
    evaluate_every: steps between evaluations on the held-out points.
    held_out: share of the points that training does not see; the state with the smallest error
        there is kept.
    from_targets: whether irradiance starts from the mean of the nearest targets instead of what the
        field has.
    anisotropic: whether the three scales of a Gaussian are free of each other.
    seed: of the split and the batches.
    """

    steps: int = 1000
    batch: int = 32_768
    rates: LearningRates = field(default_factory=LearningRates)
    final_rate: float = 0.1
    rebuild_every: int = 100
    evaluate_every: int = 50
    held_out: float = 0.1
    from_targets: bool = False
    anisotropic: bool = True
    seed: int = 0


def cosine_decay(done: float, final: float) -> float:
    """A cosine from 1 to ``final`` while ``done`` goes from 0 to 1."""
    return final + (1 - final) * 0.5 * (1 + math.cos(math.pi * min(done, 1.0)))

"""Streaming supervision: the field learns while photons come in, from what they say so far.

Targets need not be converged before training starts: where the Gaussians should lie, and what most
of them should answer, is known after a few passes, and noise that many points have on their own
averages out over a Gaussian. Passes and optimiser steps take turns; each round of steps learns from
the mean over all passes before it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from gpf.progressive import PhotonPasses
from gpf.structs import SurfacePoints, VisiblePoints
from gpf.supervision import Loss, loss_weights
from gpf.training import Progress, Trainer

# Of the random numbers with which points sample the emitters.
STREAM = 11


@dataclass(frozen=True)
class StreamSettings:
    """How passes and steps take turns.

    Attributes
    ----------
    passes: of photons, in all.
    first: passes before the first step.
    growth: a new round of steps begins when there are so many times as many passes.
    """

    passes: int = 250
    first: int = 8
    growth: float = 1.25

    def rounds(self) -> list[int]:
        """Numbers of passes after which steps are made, ascending; the last is ``passes``."""
        counts, count = [], min(self.first, self.passes)
        while count < self.passes:
            counts.append(count)
            count = max(round(count * self.growth), count + 1)
        return [*counts, self.passes]


class PhotonStream:
    """Points whose irradiance becomes known pass by pass.

    Parameters
    ----------
    points: all of them valid, (P,).
    loss: what weighs the points; see :func:`gpf.supervision.loss_weights`.
    """

    def __init__(self, passes: PhotonPasses, points: VisiblePoints, loss: Loss) -> None:
        self.passes, self.points, self.loss = passes, points, loss
        self.count = 0
        self._sum = dr.zeros(mi.Color3f, dr.width(points.p))

    def advance(self, count: int, tick: Callable[[int], None] = lambda done: None) -> None:
        """Add passes until there are ``count``."""
        while self.count < count:
            self.count += 1
            irradiance, _ = self.passes.trace(self.count).all_irradiance(self.points, STREAM)
            self._sum += irradiance
            dr.eval(self._sum)
            dr.sync_thread()
            tick(self.count)

    def supervised_points(self) -> SurfacePoints:
        """The points with the mean over all passes so far as their targets."""
        target = self._sum / dr.opaque(mi.Float, max(self.count, 1))
        weight = loss_weights(target.numpy().T, self.loss)
        points = SurfacePoints(self.points.p, self.points.n, target, mi.Float(weight))
        dr.eval(points)
        return points


def train_on_stream(
    trainer: Trainer,
    stream: PhotonStream,
    settings: StreamSettings,
    report: Callable[[Progress], None] = lambda progress: None,
    tick: Callable[[int, int], None] = lambda passes, steps: None,
) -> None:
    """Take turns until all passes and all of the trainer's steps are done.

    Steps are shared out over the rounds in proportion to what passes have come in. ``report`` is
    called after each round, ``tick`` with the number of passes and steps after each of either.
    """
    steps, done = trainer.settings.steps, trainer.step_count
    for count in settings.rounds():
        stream.advance(count, lambda passes: tick(passes, trainer.step_count))
        trainer.retarget(stream.supervised_points())
        wanted = max(round(steps * count / settings.passes), done)
        while trainer.step_count < wanted:
            errors = trainer.advance(1)
            tick(stream.count, trainer.step_count)
        if wanted > done:
            report(trainer.judge(errors))
        done = wanted

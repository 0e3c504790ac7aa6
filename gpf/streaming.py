"""Streaming supervision: the field learns while photons come in, from what they say so far.

Targets need not be converged before training starts: where the Gaussians should lie, and what most
of them should answer, is known after a few passes, and noise that many points have on their own
averages out over a Gaussian. Passes and optimiser steps take turns; each round of steps learns from
the mean over all passes before it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.fixed_points import FixedPoints
from gpf.progressive import PhotonPass, PhotonPasses
from gpf.structs import SurfacePoints, VisiblePoints, concatenate, take, to_numpy
from gpf.supervision import Targets
from gpf.training import Progress, Trainer

# Of the random numbers with which points sample the emitters.
STREAM = 1000


@dataclass(frozen=True)
class StreamSettings:
    """How passes and steps take turns.

    Attributes
    ----------
    passes: of photons, in all.
    first: passes before the first step.
    growth: a new round of steps begins when there are so many times as many passes.
    """

    passes: int = 300
    first: int = 24
    growth: float = 1.5

    def rounds(self) -> list[int]:
        """Numbers of passes after which steps are made, ascending; the last is ``passes``."""
        counts, count = [], min(self.first, self.passes)
        while count < self.passes:
            counts.append(count)
            count = max(round(count * self.growth), count + 1)
        return [*counts, self.passes]


class PhotonStream:
    """Points whose irradiance becomes known pass by pass.

    A photon counts at all points within the kernel's radius, which are many more than are needed
    to make use of it: each pass serves one of several interleaved sets of the points.

    Parameters
    ----------
    points: by their source: the number of the view that sees them, or
        :data:`gpf.supervision.SURFACE`.
    sets: into so many the points are divided; as many passes are the least that serves all.
    """

    def __init__(
        self, passes: PhotonPasses, points: Mapping[int, VisiblePoints], sets: int = 1
    ) -> None:
        self.passes, self.count = passes, 0
        valid = [take(each, dr.compress(each.valid)) for each in points.values()]
        joined = concatenate(valid)
        source = np.repeat(np.array(list(points), np.int32), [dr.width(each.p) for each in valid])
        lanes = np.arange(len(source), dtype=np.uint32)
        self._sets = [
            _PointSet(
                FixedPoints(passes.scene, take(joined, mi.UInt32(lanes[k::sets]))), source[k::sets]
            )
            for k in range(sets)
        ]

    def advance(self, count: int, tick: Callable[[int], None] = lambda done: None) -> None:
        """Add passes until there are ``count``."""
        while self.count < count:
            self.count += 1
            number = self.count % len(self._sets)
            self._sets[number].add(self.passes.trace(self.count), STREAM + number)
            dr.sync_thread()
            tick(self.count)

    def targets(self) -> Targets:
        """The points with the mean over all passes so far that served them."""
        return Targets.join([points.targets() for points in self._sets])


class _PointSet:
    """Points with the sum over the passes that served them."""

    def __init__(self, points: FixedPoints, source: np.ndarray) -> None:
        self.points, self.source, self.count = points, source, 0
        self.irradiance, self.direct = (dr.zeros(mi.Color3f, len(source)) for _ in range(2))

    def add(self, photons: PhotonPass, stream: int) -> None:
        self.count += 1
        irradiance, direct = photons.all_irradiance(self.points, stream, self.count)
        self.irradiance += irradiance
        if direct is not None:
            self.direct += direct
        dr.eval(self.irradiance, self.direct)

    def targets(self) -> Targets:
        points, passes = self.points.points, max(self.count, 1)
        return Targets(
            position=to_numpy(points.p),
            normal=to_numpy(points.n),
            irradiance=to_numpy(self.irradiance) / passes,
            direct=to_numpy(self.direct) / passes,
            reflectance=to_numpy(points.reflectance),
            source=self.source,
        )


def train_on_stream(
    trainer: Trainer,
    stream: PhotonStream,
    settings: StreamSettings,
    supervise: Callable[[Targets], SurfacePoints],
    report: Callable[[Progress], None] = lambda progress: None,
    tick: Callable[[int, int], None] = lambda passes, steps: None,
) -> None:
    """Take turns until all passes and all of the trainer's steps are done.

    Steps are shared out over the rounds in proportion to what passes have come in.

    Parameters
    ----------
    supervise: from targets to the points that the trainer has.
    report: called after each round.
    tick: called with the number of passes and steps after each of either.
    """
    steps, done = trainer.settings.steps, trainer.step_count
    for count in settings.rounds():
        stream.advance(count, lambda passes: tick(passes, trainer.step_count))
        wanted = round(steps * count / settings.passes)
        if wanted == done and count < settings.passes:
            continue
        trainer.retarget(supervise(stream.targets()))
        while trainer.step_count < wanted:
            trainer.advance(1)
            tick(stream.count, trainer.step_count)
        report(trainer.judge())
        done = wanted

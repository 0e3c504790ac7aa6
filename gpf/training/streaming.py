"""Streaming supervision: the field learns while photons come in, from what they say so far.

Targets need not be converged before training starts: where the Gaussians should lie, and what most
of them should answer, is known after a few passes, and noise that many points have on their own
averages out over a Gaussian. Passes and optimiser steps take turns; each round of steps learns from
the mean over all passes before it.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from typing import Annotated

import drjit as dr
import mitsuba as mi
import numpy as np
from pydantic import Field

from gpf.core.random import Stream, pass_seed, random_start, spread_sample
from gpf.core.settings import Count, Positive, Seed, Settings
from gpf.core.structs import SurfacePoints, VisiblePoints, concatenate, take, to_numpy
from gpf.photons.emission import Source, emit_light
from gpf.photons.photon_grid import PhotonSums
from gpf.scene.bounds import scene_bounds
from gpf.sppm.density import PhotonDensity, radius_at
from gpf.sppm.edge_correction import area_correction
from gpf.sppm.fixed_points import FixedPoints
from gpf.sppm.passes import PassSettings, suit_scene
from gpf.training.targets import Targets
from gpf.training.trainer import Progress, Trainer

# Edge of the cells in which photons are added up, in units of the kernel's radius after so many
# passes.
CELL, TYPICAL_PASSES = 0.25, 100

# Samples of the emitters that each point gets whenever targets are asked for.
DIRECT_SAMPLES = 8


class StreamSettings(Settings):
    """How passes and steps take turns.

    Attributes
    ----------
    passes: of photons, in all.
    first: passes before the first step.
    growth: a new round of steps begins when there are so many times as many passes.
    alpha: radius reduction, in (0, 1).
    radius: of the first pass, in units of that of the references.
    view_points, surface_points: supervised points that views see, and on surfaces, at most.
    """

    passes: Count = 300
    first: Count = 24
    growth: Annotated[float, Field(gt=1)] = 2.0
    alpha: Annotated[float, Field(gt=0, lt=1)] = 0.75
    radius: Positive = 1.3
    view_points: Count = 200_000
    surface_points: Count = 300_000
    seed: Seed = 6

    def rounds(self) -> list[int]:
        """Numbers of passes after which steps are made, ascending; the last is ``passes``."""
        counts, count = [], min(self.first, self.passes)
        while count < self.passes:
            counts.append(count)
            count = max(round(count * self.growth), count + 1)
        return [*counts, self.passes]


class PhotonStream:
    """Photons that come in pass by pass, and what they say at points so far.

    Photons are added up in cells (:class:`gpf.photons.photon_grid.PhotonSums`), so that a pass costs the
    same however many points there are; whenever targets are asked for, all photons so far are
    gathered with one radius, that which pass n of SPPM would have.

    Parameters
    ----------
    settings: of the passes; ``alpha`` and ``initial_radius`` give the radius.
    points: by their source: the number of the view that sees them, or
        :data:`gpf.training.targets.SURFACE`.
    """

    def __init__(
        self,
        scene: mi.Scene,
        settings: PassSettings,
        points: Mapping[int, VisiblePoints],
        seed: int,
        source: Source = emit_light,
    ) -> None:
        self.scene, self.seed, self.count = scene, seed, 0
        self.settings = suit_scene(settings, scene)
        self._bounds = scene_bounds(scene)
        self._apart = self.settings.direct == "emitters"
        # The smallest radius there will be is not known, but that it shrinks slowly.
        self._cell = CELL * radius_at(
            TYPICAL_PASSES, self.settings.initial_radius, self.settings.alpha
        )
        self._paths = self.settings.path_settings(source)
        self.sums = PhotonSums(self._cell, self._bounds, self._paths)
        valid = [take(each, dr.compress(each.valid)) for each in points.values()]
        self._source = np.repeat(
            np.array(list(points), np.int32), [dr.width(each.p) for each in valid]
        )
        self._points = FixedPoints(scene, concatenate(valid))
        self._direct = dr.zeros(mi.Color3f, len(self._source))
        self._samples = 0

    def independent(self, every: int = 1) -> PhotonStream:
        """As many passes of other photons, for one in ``every`` of the same points."""
        other = copy.copy(self)
        other._source = self._source[::every]
        lanes = every * dr.arange(mi.UInt32, len(other._source))
        other._points = FixedPoints(self.scene, take(self._points.points, lanes))
        other.seed, other.count = pass_seed(self.seed, 0, Stream.STREAM_JUDGES), 0
        other.sums = PhotonSums(self._cell, self._bounds, self._paths)
        other._direct, other._samples = dr.zeros(mi.Color3f, len(other._source)), 0
        other.advance(self.count)
        return other

    def advance(self, count: int, tick: Callable[[int], None] = lambda done: None) -> None:
        """Add passes until there are ``count``."""
        while self.count < count:
            self.count += 1
            self.sums.trace(self.scene, pass_seed(self.seed, self.count, Stream.PHOTONS))
            dr.sync_thread()
            tick(self.count)

    def targets(self) -> Targets:
        """The points with what all passes so far say."""
        points, irradiance = self._points.points, to_numpy(self._gather())
        if self._apart:
            self._sample_emitters()
        direct = to_numpy(self._direct) / np.float32(max(self._samples, 1))
        return Targets(
            position=to_numpy(points.p),
            normal=to_numpy(points.n),
            irradiance=irradiance + direct,
            direct=direct,
            reflectance=to_numpy(points.reflectance),
            source=self._source,
        )

    def _gather(self) -> mi.Color3f:
        points, n = self._points.points, self._points.points.n
        radius = radius_at(self.count, self.settings.initial_radius, self.settings.alpha)
        density = PhotonDensity(self.sums.photons(), radius, self._bounds, smooth=True)
        irradiance = density.irradiance(points.p, n)
        if self.settings.edge_correction:
            seed = pass_seed(self.seed, self.count, Stream.EDGES)
            irradiance *= area_correction(
                self.scene, points.p, n, points.valid, radius, seed, smooth=True
            )
        return irradiance

    def _sample_emitters(self) -> None:
        """Add to the direct light at the points; what a few samples miss, later rounds make up."""
        start = random_start(pass_seed(self.seed, 0, Stream.STREAM_EMITTERS), len(self._source))
        for _ in range(DIRECT_SAMPLES):
            self._samples += 1
            sample = spread_sample(start, self._samples)
            self._direct += self._points.direct_irradiance(sample)
            dr.eval(self._direct)


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
        wanted = round(steps * count / settings.passes)
        fresh = count > stream.count
        stream.advance(count, lambda passes: tick(passes, trainer.step_count))
        if wanted == done and count < settings.passes:
            continue
        if fresh:  # the first round's are those that the trainer began with
            trainer.retarget(supervise(stream.targets()))
        while trainer.step_count < wanted:
            trainer.advance(1)
            tick(stream.count, trainer.step_count)
        report(trainer.judge())
        done = wanted

"""Streaming supervision: the field is trained while passes are traced.

Training does not need converged targets: a few passes show where the Gaussians should lie and what
most of them should store, and the independent noise of many points averages out over a Gaussian.
Passes and optimiser steps alternate; each round of steps learns from the photons of all passes
before it.
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
from gpf.training.targets import Targets, source_numbers
from gpf.training.trainer import Progress, Trainer

# Edge of the cells in which photons are added up, in units of the kernel radius after
# TYPICAL_PASSES passes.
CELL, TYPICAL_PASSES = 0.25, 100

# Samples of the emitters at each point for each call of PhotonStream.targets.
DIRECT_SAMPLES = 8


class StreamSettings(Settings):
    """Settings of the stream: how passes and steps alternate, and the supervised points.

    Attributes
    ----------
    passes: photon passes in all.
    first: passes before the first step.
    growth: between two rounds of steps, the number of passes grows by this factor.
    alpha: radius reduction, in (0, 1).
    radius: radius of the first pass, in units of the references' first radius.
    view_points, surface_points: largest number of supervised points that training views see, and
        of supervised samples of surfaces.
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
    """Photons of a growing number of passes, and the targets that they give at fixed points.

    Photons are added up in cells (:class:`gpf.photons.photon_grid.PhotonSums`), so the cost of a
    pass does not depend on the number of points. For targets, all photons of n passes are gathered
    with one radius: the radius of pass n of SPPM.

    Parameters
    ----------
    settings: of the passes; ``alpha`` and ``initial_radius`` give the radius.
    points: sets of points by name: each training view in order, then
        :data:`gpf.training.targets.SURFACES`; any of them may be missing.
    """

    def __init__(
        self,
        scene: mi.Scene,
        settings: PassSettings,
        points: Mapping[str, VisiblePoints],
        seed: int,
        source: Source = emit_light,
    ) -> None:
        self.scene, self.seed, self.count = scene, seed, 0
        self.settings = suit_scene(settings, scene)
        self._bounds = scene_bounds(scene)
        # The final radius is not known here, but the radius shrinks slowly.
        self._cell = CELL * radius_at(
            TYPICAL_PASSES, self.settings.initial_radius, self.settings.alpha
        )
        self._paths = self.settings.path_settings(source)
        self.sums = PhotonSums(self._cell, self._bounds, self._paths)
        valid = [take(each, dr.compress(each.valid)) for each in points.values()]
        self._source = np.repeat(source_numbers(points), [dr.width(each.p) for each in valid])
        self._points = FixedPoints(scene, concatenate(valid))
        self._direct = dr.zeros(mi.Color3f, len(self._source))
        self._samples = 0

    def independent(self, every: int = 1) -> PhotonStream:
        """A stream with as many passes of other photons, at every ``every``-th point."""
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
        """Add passes until there are ``count``; ``tick(done)`` is called after each."""
        while self.count < count:
            self.count += 1
            self.sums.trace(self.scene, pass_seed(self.seed, self.count, Stream.PHOTONS))
            dr.sync_thread()
            tick(self.count)

    def targets(self) -> Targets:
        """The points, with the irradiance from all passes so far."""
        points, irradiance = self._points.points, to_numpy(self._gather())
        if self.settings.direct == "emitters":
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
        """Add samples of direct light at the points; each round adds more and has less noise."""
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
    """Alternate passes and steps until all passes and all of the trainer's steps are done.

    The share of the steps that are done after a round is the share of the passes.

    Parameters
    ----------
    supervise: makes the trainer's points from targets.
    report: called after each round.
    tick: called with the numbers of passes and steps, after each pass and each step.
    """
    steps, done = trainer.settings.steps, trainer.step_count
    for count in settings.rounds():
        wanted = round(steps * count / settings.passes)
        fresh = count > stream.count
        stream.advance(count, lambda passes: tick(passes, trainer.step_count))
        if wanted == done and count < settings.passes:
            continue
        if fresh:  # the trainer already has the targets of the first round
            trainer.retarget(supervise(stream.targets()))
        while trainer.step_count < wanted:
            trainer.advance(1)
            tick(stream.count, trainer.step_count)
        report(trainer.judge())
        done = wanted

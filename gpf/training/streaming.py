"""Streaming supervision: targets from the photons of any number of passes.

Training does not need converged targets: the noise of many points averages out over a Gaussian. The
photons of all passes are kept, so that a field can be fitted after some passes, and again after
more.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Annotated

import drjit as dr
import mitsuba as mi
import numpy as np
from pydantic import Field

from gpf.core.random import Stream, pass_seed, random_start, spread_sample
from gpf.core.settings import Count, Positive, Seed, Settings
from gpf.core.structs import VisiblePoints, concatenate, take, to_numpy
from gpf.photons.emission import Source, emit_light
from gpf.photons.photon_grid import PhotonSums
from gpf.scene.bounds import scene_bounds
from gpf.sppm.density import PhotonDensity, radius_at
from gpf.sppm.edge_correction import area_correction
from gpf.sppm.fixed_points import FixedPoints
from gpf.sppm.passes import PassSettings, suit_scene
from gpf.training.targets import Targets, source_numbers

# Edge of the cells in which photons are added up, in units of the kernel radius after
# TYPICAL_PASSES passes.
CELL, TYPICAL_PASSES = 0.25, 100

# Samples of the emitters at each point for each half and each call of PhotonStream.halves.
DIRECT_SAMPLES = 4


class StreamSettings(Settings):
    """Settings of the stream: its passes, and the supervised points.

    Attributes
    ----------
    passes: photon passes in all.
    alpha: radius reduction, in (0, 1).
    radius: radius of the first pass, in units of the references' first radius.
    view_points, surface_points: largest number of supervised points that training views see, and
        of supervised samples of surfaces.
    """

    passes: Count = 300
    alpha: Annotated[float, Field(gt=0, lt=1)] = 0.75
    radius: Positive = 1.3
    view_points: Count = 200_000
    surface_points: Count = 300_000
    seed: Seed = 6


class PhotonStream:
    """Photons of a growing number of passes, and the targets that they give at fixed points.

    Photons are added up in cells (:class:`gpf.photons.photon_grid.PhotonSums`), so the cost of a
    pass does not depend on the number of points. For targets, all photons of n passes are gathered
    with one radius: the radius of pass n of SPPM. Passes with odd and with even numbers are added
    up apart: these two halves are independent.

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
        cell = CELL * radius_at(TYPICAL_PASSES, self.settings.initial_radius, self.settings.alpha)
        paths = self.settings.path_settings(source)
        self._sums = [PhotonSums(cell, self._bounds, paths) for _ in range(2)]
        valid = [take(each, dr.compress(each.valid)) for each in points.values()]
        self._source = np.repeat(source_numbers(points), [dr.width(each.p) for each in valid])
        self._points = FixedPoints(scene, concatenate(valid))
        self._direct = [dr.zeros(mi.Color3f, len(self._source)) for _ in range(2)]
        self._samples = 0

    @property
    def radius(self) -> float:
        """Radius of the kernel with which photons are gathered, world units."""
        return radius_at(max(self.count, 1), self.settings.initial_radius, self.settings.alpha)

    def advance(self, count: int, tick: Callable[[int], None] = lambda done: None) -> None:
        """Add passes until there are ``count``; ``tick(done)`` is called after each."""
        while self.count < count:
            self.count += 1
            half = self._sums[self.count % 2]
            half.trace(self.scene, pass_seed(self.seed, self.count, Stream.PHOTONS))
            dr.sync_thread()
            tick(self.count)

    def mean(self, halves: tuple[Targets, Targets]) -> Targets:
        """The points, with the irradiance from all passes so far; ``halves``: of :meth:`halves`."""
        even, odd = halves
        share = self.count // 2 / self.count
        return replace(
            even,
            irradiance=share * even.irradiance + (1 - share) * odd.irradiance,
            direct=(even.direct + odd.direct) / 2,
        )

    def halves(self) -> tuple[Targets, Targets]:
        """The points, with the irradiance from passes with even and with odd numbers."""
        points = self._points.points
        if self.settings.direct == "emitters":
            self._sample_emitters()
        found = []
        for half in range(2):
            density = PhotonDensity(
                self._sums[half].photons(), self.radius, self._bounds, smooth=True
            )
            gathered = density.irradiance(points.p, points.n)
            if self.settings.edge_correction:
                seed = pass_seed(self.seed, 2 * self.count + half, Stream.EDGES)
                gathered *= area_correction(
                    self.scene, points.p, points.n, points.valid, self.radius, seed, smooth=True
                )
            irradiance = to_numpy(gathered)
            direct = to_numpy(self._direct[half]) / np.float32(max(self._samples, 1))
            found.append(
                Targets(
                    position=to_numpy(points.p),
                    normal=to_numpy(points.n),
                    irradiance=irradiance + direct,
                    direct=direct,
                    reflectance=to_numpy(points.reflectance),
                    source=self._source,
                )
            )
        return found[0], found[1]

    def _sample_emitters(self) -> None:
        """Add samples of direct light at the points; each round adds more and has less noise."""
        for half in range(2):
            seed = pass_seed(self.seed, half, Stream.STREAM_EMITTERS)
            start = random_start(seed, len(self._source))
            for k in range(DIRECT_SAMPLES):
                sample = spread_sample(start, self._samples + k + 1)
                self._direct[half] += self._points.direct_irradiance(sample)
                dr.eval(self._direct)
        self._samples += DIRECT_SAMPLES

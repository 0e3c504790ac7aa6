"""Direct light at supervised points, from samples of the emitters, in two independent halves."""

from __future__ import annotations

import math
from functools import cached_property

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.errors import uninterrupted
from gpf.core.random import Stream, pass_seed, random_start, spread_sample
from gpf.core.structs import from_numpy, to_numpy
from gpf.guiding.lamp_guide import LampGuide, count_bins, find_cells
from gpf.scene.lamps import Lamps
from gpf.sppm.fixed_points import FixedPoints
from gpf.training.loss import relative_weight

LEAST = 4
"""Samples at each point for each half, at least."""

MOST_PER_PASS = 8.0
"""Samples at each point for each half that come with a pass of photons, at most."""

COST = 5.0
"""A pass takes about as long as so many samples at each point for both halves."""

PILOT = 8
"""Samples at each point from which a guide learns."""

WORTH = 0.95
"""Samples are guided if their variance is below this part of that without a guide."""

SHARED_BY = 8
"""Points whose targets are compared together, because a Gaussian averages over about as many."""


class DirectLight:
    """Direct light at points.

    Most samples of a sky outside of the window find the wall. They are guided to the window
    (:mod:`gpf.guiding.lamp_guide`) if that pays. Where direct light still has more noise than that
    of the photons, more samples help more than more photons. With n samples and N passes, whose
    noise has the variances v/n and V/N, there is least noise for the time if n/N = sqrt(c v / V),
    where c is the time of a pass in that of a sample.

    Parameters
    ----------
    lamps: the emitters that are sampled.
    sign: -1 if their light is taken away from that of the photons.

    Attributes
    ----------
    samples: at each point for each half, so far.
    per_pass: how many come with a pass; 0 until :meth:`balance` has chosen.
    """

    def __init__(self, points: FixedPoints, lamps: Lamps, sign: int, seed: int) -> None:
        self.points, self.lamps, self.sign, self.seed = points, lamps, sign, seed
        self.samples, self.per_pass = 0, 0.0
        self._sums = [dr.zeros(mi.Color3f, dr.width(points.points.p)) for _ in range(2)]

    def sample(self, passes: int) -> None:
        """Add the samples that belong to so many passes."""
        wanted = max(LEAST, math.ceil(self.per_pass * passes)) if self.lamps else 0
        with uninterrupted():
            while self.samples < wanted:
                self.samples += 1
                for half in range(2):
                    seed = pass_seed(self.seed, half, Stream.STREAM_EMITTERS)
                    start = random_start(seed, dr.width(self._sums[half]))
                    found = self._light(spread_sample(start, self.samples))
                    self._sums[half] += self.sign * found
                dr.eval(self._sums)

    def _light(self, sample: mi.Point2f) -> mi.Color3f:
        """Irradiance of one sample of each point, W/m², (N, 3)."""
        if self._guide is None:
            return self.points.direct_irradiance(sample, self.lamps)
        guided, weight = self._guide.warp(sample)
        return self.points.direct_irradiance(guided, self.lamps) * weight

    @cached_property
    def _guide(self) -> LampGuide | None:
        """What a pilot has learnt; None if that does not pay."""
        p, n = (to_numpy(values) for values in (self.points.points.p, self.points.points.n))
        cell = find_cells(p, n)
        seed = pass_seed(self.seed, 0, Stream.LAMP_PILOT)
        start, found = random_start(seed, len(p)), []
        for number in range(PILOT):
            sample = spread_sample(start, number)
            light = dr.mean(self.points.direct_irradiance(sample, self.lamps))
            found.append(count_bins(cell, to_numpy(sample), light.numpy()))
        square, count = (np.sum(part, axis=0) for part in zip(*found, strict=True))
        guide = LampGuide(cell, square, count)
        return guide if guide.remaining < WORTH else None

    def mean(self, half: int) -> np.ndarray:
        """Irradiance from the samples of a half, W/m², (N, 3)."""
        return to_numpy(self._sums[half]) / np.float32(max(self.samples, 1))

    def balance(
        self,
        passes: int,
        direct: tuple[np.ndarray, np.ndarray],
        photons: tuple[np.ndarray, np.ndarray],
    ) -> None:
        """Choose how many samples come with a pass, from the noise of both kinds of light.

        Parameters
        ----------
        passes: so far.
        direct, photons: irradiance from each half at some points, (P, 3) each. Points that follow
            each other lie beside each other.
        """
        light = direct[0] + direct[1] + photons[0] + photons[1]
        sample = self.samples * _variance(direct, light)
        of_pass = passes * _variance(photons, light)
        self.per_pass = min(math.sqrt(COST * sample / max(of_pass, 1e-30)), MOST_PER_PASS)

    def tensors(self) -> dict[str, np.ndarray]:
        """The samples so far, for a file."""
        sums = np.stack([to_numpy(each) for each in self._sums])
        return {"sums": sums, "samples": np.array([self.samples, self.per_pass])}

    def restore(self, tensors: dict[str, np.ndarray]) -> None:
        """Continue from :meth:`tensors`."""
        self._sums = [from_numpy(mi.Color3f, part) for part in tensors["sums"]]
        self.samples, self.per_pass = int(tensors["samples"][0]), float(tensors["samples"][1])


def _variance(halves: tuple[np.ndarray, np.ndarray], light: np.ndarray) -> float:
    """Variance of the mean of both halves, from their difference in small groups of points,
    relative to the ``light`` there as in the loss."""
    starts = np.arange(0, len(light), SHARED_BY)
    count = np.diff(np.r_[starts, len(light)])
    difference, level = (
        np.add.reduceat(values.mean(axis=1), starts) / count
        for values in (halves[0] - halves[1], light)
    )
    unit = max(float(level.mean()), 1e-20)
    weight = count * relative_weight(level / unit)
    return float((weight * difference**2).sum() / (weight.sum() * unit**2)) / 4

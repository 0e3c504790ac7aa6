"""Light at supervised points from samples that go with the photon passes, in two halves."""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.errors import uninterrupted
from gpf.core.structs import from_numpy, to_numpy
from gpf.sppm.fixed_points import FixedPoints
from gpf.training.loss import relative_weight

RUNS, RUN = 64, 512
"""Number of runs of points that stand for all points, and their length."""

AT_ONCE = 16
"""Most samples that are added at once: Ctrl-C waits for them."""

Halves = tuple[np.ndarray, np.ndarray]
"""Irradiance of points from each half, (P, 3) each."""

SHARED_BY = 8
"""Targets are compared in groups of this many points: about what a Gaussian averages over."""


class SampledLight(ABC):
    """Irradiance of points, from samples in two independent halves.

    Where this light has more noise than that of the photons, more samples help more than more
    photons. With n samples and N passes, whose noise has the variances v/n and V/N, the noise in a
    given time is least if n/N = sqrt(c v / V), where c is the time of a pass in units of that of a
    sample.

    Attributes
    ----------
    LEAST: smallest number of samples at each point for each half.
    MOST_PER_PASS: largest number of samples per photon pass.
    COST: a pass takes about as long as this many samples at each point for both halves.
    samples: samples at each point for each half, so far.
    per_pass: samples per photon pass; 0 until :func:`balance` has chosen.
    seconds: wall-clock time of the last sample of all points for both halves; 0 before the first.
    """

    LEAST: int
    MOST_PER_PASS: float
    COST: float

    def __init__(self, points: FixedPoints, seed: int) -> None:
        self.points, self.seed = points, seed
        self.samples, self.per_pass, self.seconds = 0, 0.0, 0.0
        self._sums = [dr.zeros(mi.Color3f, dr.width(points.points.p)) for _ in range(2)]

    @abstractmethod
    def _light(self, half: int, first: int, count: int) -> mi.Color3f:
        """Sum of the irradiance of each point from ``count`` samples of a half, W/m², (N, 3);
        ``first`` is the number of the first one, counted from 1."""

    def sample(self, passes: int) -> None:
        """Add the samples that go with this many passes."""
        wanted = max(self.LEAST, math.ceil(self.per_pass * passes))
        while self.samples < wanted:
            self.add(min(wanted - self.samples, AT_ONCE))

    def add(self, count: int = 1) -> None:
        """Add samples at each point for each half."""
        with uninterrupted():
            begin = time.perf_counter()
            for half in range(2):
                light = self._light(half, self.samples + 1, count)
                dr.eval(light)  # one kernel for both halves, and for all samples
                self._sums[half] += light
            dr.eval(self._sums)
            dr.sync_thread()
            self.samples += count
            self.seconds = (time.perf_counter() - begin) / count

    def mean(self, half: int) -> np.ndarray:
        """Irradiance from the samples of a half, W/m², (N, 3)."""
        return to_numpy(self._sums[half]) / np.float32(max(self.samples, 1))

    def tensors(self) -> dict[str, np.ndarray]:
        """The samples so far, for a file."""
        sums = np.stack([to_numpy(each) for each in self._sums])
        return {"sums": sums, "samples": np.array([self.samples, self.per_pass])}

    def restore(self, tensors: dict[str, np.ndarray]) -> None:
        """Continue from :meth:`tensors`."""
        self._sums = [from_numpy(mi.Color3f, part) for part in tensors["sums"]]
        self.samples, self.per_pass = int(tensors["samples"][0]), float(tensors["samples"][1])


def some_runs(count: int) -> np.ndarray:
    """Some of ``count`` points, (P,) integers: in runs, so that they still have neighbours."""
    starts = np.linspace(0, max(count - RUN, 0), RUNS).astype(np.int64)
    return np.unique(starts[:, None] + np.arange(min(RUN, count)))


def balance(
    passes: int, photons: Halves, kinds: Sequence[SampledLight], means: Sequence[Halves]
) -> None:
    """Choose how many samples to take per photon pass, from the noise of each kind of light.

    If one kind would need more than its limit, the numbers of all are reduced in proportion.

    Parameters
    ----------
    passes: photon passes so far.
    photons: irradiance from each half at some points, (P, 3) each; consecutive points are
        neighbours.
    means: irradiance from each kind of samples, likewise.
    """
    light = np.sum([photons, *means], axis=(0, 1))
    of_pass = max(passes * _variance(photons, light), 1e-30)
    wanted = [
        math.sqrt(kind.COST * kind.samples * _variance(mean, light) / of_pass)
        for kind, mean in zip(kinds, means, strict=True)
    ]
    pairs = list(zip(kinds, wanted, strict=True))
    share = min([1.0, *(kind.MOST_PER_PASS / most for kind, most in pairs if most > 0)])
    for kind, most in pairs:
        kind.per_pass = share * most


def _variance(halves: Halves, light: np.ndarray) -> float:
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

"""Guided emission: more photons start along rays that are likely to reach the visible region.

Mitsuba's emitters make a ray from five uniform random numbers u: one for the emitter, two for the
place, two for the direction. Rays from some parts of this unit cube reach the region and those from
other parts do not: behind a window, one in a thousand does. Pilot paths show which parts do. The
cube is divided into boxes, by repeated halving, where that lowers the noise most. Box b, of volume
V_b, is chosen with probability P_b, the numbers are uniform in it, and the power of a photon is

    Φ' = Φ V_b / P_b,    P_b = V_b/4 + 3/4 V_b sqrt(m_b) / Σ V sqrt(m),

so that the expected photon map is unchanged; m_b is the mean of Φ² in the box. This P minimises the
variance of the power that reaches the region: (Σ V sqrt(m))² minus the square of the mean.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.structs import from_numpy
from gpf.guiding.pilot import Pilot
from gpf.photons.emission import Emitted, EmitterSample, emit_from

# Fraction of the photons that are emitted without guiding, so that every ray remains possible.
_UNIFORM = 0.25

_MOST_EMITTERS = 64
_MOST_BOXES = 1 << 14
_MOST_HALVINGS = 40

# A box is divided if that lowers the variance by more than this many times what chance would do.
# Chance alone lowers the root by 1 / 8n if n paths of equal power have reached the region from it.
_SIGNIFICANT = 8

# Each box is credited with this many extra paths, with the mean square of the box that it is half
# of: where no path of one pilot has reached the region, one of the next may.
_PRIOR = 0.5


@dataclass(frozen=True)
class Boxes:
    """Boxes that fill the unit cube: corners and edges, (B, 5) each, and what is known of them.

    Attributes
    ----------
    mean: mean square m of the power that their rays bring into the region, W², (B,).
    """

    corner: np.ndarray
    edges: np.ndarray
    mean: np.ndarray

    @property
    def volume(self) -> np.ndarray:
        """Volumes, (B,)."""
        return np.asarray(self.edges.prod(axis=1))

    @classmethod
    def whole(cls, emitters: int) -> Boxes:
        """One box for each emitter."""
        corner, edges = np.zeros((emitters, 5)), np.ones((emitters, 5))
        corner[:, 0], edges[:, 0] = np.arange(emitters) / emitters, 1 / emitters
        return cls(corner, edges, np.ones(emitters))


class EmissionGuide:
    """A density over the random numbers that determine emitted rays."""

    def __init__(self, boxes: Boxes) -> None:
        self.boxes = boxes
        # Where nothing is known to reach the region, all rays are equally likely.
        wanted = boxes.volume * np.sqrt(boxes.mean if boxes.mean.any() else 1)
        share = _UNIFORM * boxes.volume + (1 - _UNIFORM) * wanted / wanted.sum()
        # At most 1: rounding must not put a number beyond the last box.
        cumulated = np.minimum(np.cumsum(share), 1).astype(np.float32)
        cumulated[-1] = 1
        self._cumulated = from_numpy(mi.Float, cumulated)
        # The probability after rounding, because the rounded distribution is sampled.
        chance = np.diff(cumulated.astype(np.float64), prepend=0)
        self.density = chance / boxes.volume
        self._density = from_numpy(mi.Float, self.density)
        self._corner = [from_numpy(mi.Float, x) for x in boxes.corner.T]
        self._edges = [from_numpy(mi.Float, x) for x in boxes.edges.T]

    def draw(self, sampler: mi.Sampler) -> tuple[EmitterSample, mi.UInt32]:
        """The random numbers of emitted rays, and their boxes, (N,)."""
        u = sampler.next_1d()
        # The same steps for all guides, so that none needs a kernel of its own.
        box, step, count = mi.UInt32(0), _MOST_BOXES, dr.opaque(mi.UInt32, len(self.density))
        while step:
            probe = box + step - 1
            below = dr.gather(mi.Float, self._cumulated, probe, probe < count) <= u
            box = dr.select((probe < count) & below, box + step, box)
            step //= 2
        box = dr.minimum(box, count - 1)
        numbers = []
        for number, corner, edge in zip(
            EmitterSample.draw(sampler).numbers(), self._corner, self._edges, strict=True
        ):
            # Otherwise rounding could make the last number of the last box 1.
            inside = dr.gather(mi.Float, corner, box) + dr.gather(mi.Float, edge, box) * number
            numbers.append(dr.minimum(inside, dr.one_minus_epsilon(mi.Float)))
        return EmitterSample.of(numbers), box

    def emit(self, scene: mi.Scene, sampler: mi.Sampler) -> Emitted:
        """Guided rays from the emitters of the scene, their powers, W, and emitters: (N,) each."""
        start, box = self.draw(sampler)
        ray, power, emitter = emit_from(scene, start)
        return ray, power / dr.gather(mi.Float, self._density, box), emitter

    @classmethod
    def learn(
        cls, scene: mi.Scene, pilot: Pilot, guide: EmissionGuide | None = None
    ) -> EmissionGuide:
        """Learn from a pilot whose paths were emitted by ``guide`` or, without a guide, with all
        rays equally likely."""
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(pilot.seed, len(pilot.power))
        if guide is None:
            start = EmitterSample.draw(sampler)
            boxes = Boxes.whole(min(len(scene.emitters()), _MOST_EMITTERS))
            choice = np.asarray(start.choice.numpy())
            number = np.minimum((choice * len(boxes.mean)).astype(np.int64), len(boxes.mean) - 1)
            density = np.ones(len(number))
        else:
            start, box = guide.draw(sampler)
            boxes, number = guide.boxes, np.asarray(box.numpy())
            density = guide.density[number]
        numbers = np.stack([np.asarray(x.numpy()) for x in start.numbers()], axis=1)
        # How much of the cube each path stands for, and the power it would have without a guide.
        weight = 1 / (len(number) * density)
        square = weight * (pilot.power * density) ** 2
        return cls(_divide(boxes, numbers, number, weight, square))


def _divide(
    boxes: Boxes, numbers: np.ndarray, box: np.ndarray, weight: np.ndarray, square: np.ndarray
) -> Boxes:
    """The boxes, halved where it pays.

    Parameters
    ----------
    numbers: random numbers of the paths, (N, 5).
    box: index of each path's box, (N,).
    weight: how much of the cube each path stands for, (N,).
    square: ``weight`` times the square of the path's power, (N,).
    """
    corner, edges = boxes.corner.copy(), boxes.edges.copy()
    mean = _mean(box, square, weight, boxes.mean * square.sum() / max(_total(boxes), 1e-300))
    open_ = np.ones(len(mean), bool)
    for _ in range(_MOST_HALVINGS):
        count = len(mean)
        volume = edges.prod(axis=1)
        whole = np.bincount(box, square, count)
        fourth = np.bincount(box, square**2, count)
        paths = whole**2 / np.maximum(fourth, 1e-300)
        high = numbers >= (corner + edges / 2)[box]
        roots = np.empty((count, 5))
        for axis in range(5):
            upper = np.bincount(box, square * high[:, axis], count)
            roots[:, axis] = np.sqrt(upper) + np.sqrt(np.maximum(whole - upper, 0))
        roots *= np.sqrt(volume / 2)[:, None]
        least = roots.min(axis=1)
        root = np.sqrt(volume * whole)
        divided = (
            open_ & (paths > 2) & (root - least > _SIGNIFICANT / 8 * root / np.maximum(paths, 1))
        )
        divided &= root - least > 1e-5 * root.sum()
        chosen = np.flatnonzero(divided)[: _MOST_BOXES - count]
        if len(chosen) == 0:
            break
        axis = roots[chosen].argmin(axis=1)
        place = np.full(count, -1)
        place[chosen] = np.arange(len(chosen))
        edges[chosen, axis] /= 2
        further = corner[chosen].copy()
        further[np.arange(len(chosen)), axis] += edges[chosen, axis]
        corner = np.concatenate([corner, further])
        edges = np.concatenate([edges, edges[chosen]])
        moved = place[box] >= 0
        moved &= high[np.arange(len(box)), axis[np.maximum(place[box], 0)]]
        box = np.where(moved, count + place[box], box)
        before = np.concatenate([mean, mean[chosen]])
        mean = _mean(box, square, weight, before)
        open_ = np.zeros(len(mean), bool)
        open_[chosen] = open_[count:] = True
    return Boxes(corner, edges, mean)


def _total(boxes: Boxes) -> float:
    return float((boxes.volume * boxes.mean).sum())


def _mean(
    box: np.ndarray, square: np.ndarray, weight: np.ndarray, before: np.ndarray
) -> np.ndarray:
    """Mean square of the power in each box, (B,), from its paths and what was known ``before``."""
    count = len(before)
    paths = np.bincount(box, minlength=count)
    volume = np.bincount(box, weight, count)
    found = np.bincount(box, square, count) / np.maximum(volume, 1e-300)
    return np.asarray((paths * found + _PRIOR * before) / (paths + _PRIOR))

"""Guided emission: more photons start with rays that are likely to reach the visible region.

Mitsuba's emitters make a ray from five uniform random numbers u: one for the emitter, two for the
place, two for the direction. For every emitter, the rays of some parts of this unit cube reach the
region and those of other parts do not. A histogram p over the cube is learned from a pilot. The
numbers are drawn from it, and the power of a photon is divided by the density of its cell,

    Φ' = Φ / p(u),    p(u) = 1/5 + 4/5 p_learned(u),

so that the expected photon map is unchanged.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.structs import from_numpy
from gpf.guiding.pilot import Pilot
from gpf.photons.emission import Emitted, EmitterSample, emit_from

# Number of cells along each number of the place and of the direction, finest first. The first grid
# with at least _PATHS_PER_CELL paths of the pilot per cell is used.
_GRIDS = ((4, 16), (4, 8), (2, 8), (2, 4), (1, 4), (1, 2), (1, 1))
_PATHS_PER_CELL = 64
_MOST_EMITTERS = 64
# Part of the photons that are emitted without guiding, so that every ray remains possible.
_UNIFORM = 0.2


class EmissionGuide:
    """A density p over the random numbers that determine emitted rays.

    Parameters
    ----------
    shape: number of cells along choice, place (2) and direction (2).
    use: non-negative value per cell; p_learned is proportional to it.
    """

    def __init__(self, shape: tuple[int, ...], use: np.ndarray) -> None:
        self.shape = shape
        self._cells = use.size
        share = _UNIFORM / use.size + (1 - _UNIFORM) * use / use.sum()
        # At most 1: rounding must not put a number behind the last cell.
        cumulated = np.minimum(np.cumsum(share), 1).astype(np.float32)
        cumulated[-1] = 1
        self._cumulated = from_numpy(mi.Float, cumulated)
        # The density after rounding, because the rounded distribution is sampled.
        density = np.diff(cumulated.astype(np.float64), prepend=0) * use.size
        self._density = from_numpy(mi.Float, density)

    @classmethod
    def learn(cls, scene: mi.Scene, pilot: Pilot) -> EmissionGuide:
        """Learn from the power that the paths of a pilot bring into the region.

        The density of a cell is proportional to the root mean square of the power of its paths,
        which minimises the variance of the total power.
        """
        emitters = min(len(scene.emitters()), _MOST_EMITTERS)
        paths = len(pilot.power)
        shapes = [(emitters, p, p, d, d) for p, d in _GRIDS]
        shape = next((s for s in shapes if np.prod(s) * _PATHS_PER_CELL <= paths), shapes[-1])
        cell = np.asarray(_cell(pilot.start(), shape).numpy())
        size = int(np.prod(shape))
        count = np.bincount(cell, minlength=size)
        square = np.bincount(cell, pilot.power**2, minlength=size)
        use = np.sqrt(square / np.maximum(count, 1))
        return cls(shape, use if use.any() else np.ones(size))

    def emit(self, scene: mi.Scene, sampler: mi.Sampler) -> Emitted:
        """Guided rays from the emitters of the scene, their powers, W, and emitters: (N,) each."""
        u = sampler.next_1d()
        cell, step = mi.UInt32(0), 1 << (self._cells - 1).bit_length()
        while step:
            probe = cell + step - 1
            below = dr.gather(mi.Float, self._cumulated, probe, probe < self._cells) <= u
            cell = dr.select((probe < self._cells) & below, cell + step, cell)
            step //= 2
        cell = dr.minimum(cell, self._cells - 1)
        start = EmitterSample.draw(sampler)
        rest, numbers = mi.UInt32(cell), []
        for size, number in zip(reversed(self.shape), reversed(start.numbers()), strict=True):
            # Rounded, the last number of the last cell would be 1.
            inside = (mi.Float(rest % size) + number) / size
            numbers.append(dr.minimum(inside, dr.one_minus_epsilon(mi.Float)))
            rest //= size
        ray, power, emitter = emit_from(scene, EmitterSample.of(numbers[::-1]))
        return ray, power / dr.gather(mi.Float, self._density, cell), emitter


def _cell(start: EmitterSample, shape: tuple[int, ...]) -> mi.UInt32:
    """The index of the cell that contains each sample, (N,)."""
    cell = mi.UInt32(0)
    for size, number in zip(shape, start.numbers(), strict=True):
        cell = cell * size + dr.minimum(mi.UInt32(number * size), size - 1)
    return cell

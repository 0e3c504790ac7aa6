"""A grid of a volume's occupied cells; rays skip the others."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from baselines.neural.hash_encoding import Cube
from gpf.core.random import step_random
from gpf.core.structs import from_numpy
from gpf.scene.pinhole import Pinhole

# A cell is empty if the opacity of one ray step in it is below this, or below that of the mean
# density if that is less: at the beginning all densities are low.
LEAST_OPACITY = 0.01

# The stored density of a cell is multiplied by this before each update. Müller and others use 0.95;
# they make ten times as many updates.
MEMORY = 0.8

# An update visits every TURNS-th cell; the next one visits the cells beside them.
TURNS = 4


class OccupancyGrid:
    """The unit cube in R³ cells, each with an upper bound on the densities found in it.

    A cell that no training view sees is always empty, because nothing could be learned there.

    Parameters
    ----------
    resolution: R.
    step: length of a ray's steps, in units of the cube's edge.
    """

    def __init__(self, resolution: int, step: float) -> None:
        self.resolution, self.step = resolution, step
        self.length = dr.opaque(mi.Float, step)
        count = resolution**3
        self.density = dr.opaque(mi.Float, LEAST_OPACITY / step, count)
        self.seen = dr.opaque(mi.Bool, True, count)
        self.refresh()

    def hide_unseen(self, cameras: Sequence[Pinhole], cube: Cube, near: float) -> None:
        """Mark cells that no camera sees as empty.

        A camera sees a cell whose middle is in its image and farther away than ``near``, in units
        of the cube's edge.
        """
        index = np.arange(self.resolution)
        z, y, x = np.meshgrid(index, index, index, indexing="ij")
        middle = (np.stack([x, y, z], -1).reshape(-1, 3) + 0.5) / self.resolution
        points = middle * cube.edge + np.array(cube.corner)
        seen = np.zeros(len(points), dtype=bool)
        for camera in cameras:
            pixel, depth = camera.project(points)
            inside = ((pixel >= 0) & (pixel <= np.array(camera.size))).all(axis=1)
            seen |= inside & (depth > near * cube.edge)
        self.seen = from_numpy(mi.Bool, seen)
        self.refresh()

    def update(self, density: Callable[[mi.Point3f], mi.Float], seed: int, turn: int) -> None:
        """Update some of the cells from the density at a random point in each.

        A cell keeps the maximum of this density and MEMORY times its stored density.
        """
        count = -(-(self.resolution**3) // TURNS)
        first = dr.opaque(mi.UInt32, turn % TURNS)
        cell = dr.arange(mi.UInt32, count) * TURNS + first
        active = cell < self.resolution**3
        rng = step_random(count, dr.opaque(mi.UInt32, seed), dr.opaque(mi.UInt32, turn))
        side = dr.opaque(mi.UInt32, self.resolution)
        corner = mi.Point3f(cell % side, cell // side % side, cell // (side * side))
        shift = mi.Vector3f(rng.next_float32(), rng.next_float32(), rng.next_float32())
        found = density((corner + shift) * (1 / self.resolution))
        known = dr.gather(mi.Float, self.density, cell, active) * MEMORY
        kept = mi.Float(self.density)
        dr.scatter(kept, dr.maximum(known, found), cell, active)
        self.density = kept
        self.refresh()

    def refresh(self) -> None:
        """Compute the occupied cells from the densities."""
        dr.eval(self.density, self.seen)
        mean = dr.sum(dr.select(self.seen, self.density, 0)) / dr.maximum(dr.count(self.seen), 1)
        least = dr.minimum(mean, dr.opaque(mi.Float, LEAST_OPACITY / self.step))
        self.occupied = self.seen & (self.density >= least)
        dr.eval(self.occupied)

    @property
    def share(self) -> float:
        """The share of occupied cells."""
        return int(dr.count(self.occupied)[0]) / self.resolution**3

    def cell(self, place: mi.Point3f) -> mi.UInt32:
        """The index of the cell at a place in the cube; x varies fastest."""
        side = self.resolution
        place = dr.clip(place * side, 0, side - 1)
        return mi.UInt32(place.x) + side * (mi.UInt32(place.y) + side * mi.UInt32(place.z))

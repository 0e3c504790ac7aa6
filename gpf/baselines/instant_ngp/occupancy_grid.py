"""Where in a volume there is anything: cells that rays may skip, and those that they may not."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.baselines.neural.hash_encoding import Cube
from gpf.baselines.pinhole import Pinhole
from gpf.core.random import step_random

# A cell is empty below this opacity along one step of a ray, or below that of the mean density if
# that is less: at first, nothing is dense.
LEAST_OPACITY = 0.01

# What is known of a cell's density fades by this factor from update to update. Müller and others
# have .95; they make ten times as many updates.
MEMORY = 0.8

# Cells are updated in so many turns, each of which has cells everywhere.
TURNS = 4


class OccupancyGrid:
    """The unit cube in R³ cells, each with a bound of the density that was found in it.

    A cell that no training view looks into is empty for good: whatever would be there, nothing has
    taught it.

    Parameters
    ----------
    resolution: R.
    step: length of a ray's steps, in edges of the cube.
    """

    def __init__(self, resolution: int, step: float) -> None:
        self.resolution, self.step = resolution, step
        self.length = dr.opaque(mi.Float, step)
        count = resolution**3
        self.density = dr.opaque(mi.Float, LEAST_OPACITY / step, count)
        self.seen = dr.opaque(mi.Bool, True, count)
        self.refresh()

    def hide_unseen(self, cameras: Sequence[Pinhole], cube: Cube, near: float) -> None:
        """Empty the cells whose middle is in no camera's image, or nearer to it than ``near``.

        ``near`` is in edges of the cube.
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
        self.seen = mi.Bool(seen)
        self.refresh()

    def update(self, density: Callable[[mi.Point3f], mi.Float], seed: int, turn: int) -> None:
        """Ask for the density at a random point in each cell whose turn it is.

        A cell keeps the larger of what it is told now and what it was told before, faded.
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
        """Find the occupied cells anew, from the densities."""
        dr.eval(self.density, self.seen)
        mean = dr.sum(dr.select(self.seen, self.density, 0)) / dr.maximum(dr.count(self.seen), 1)
        least = dr.minimum(mean, dr.opaque(mi.Float, LEAST_OPACITY / self.step))
        self.occupied = self.seen & (self.density >= least)
        dr.eval(self.occupied)

    @property
    def share(self) -> float:
        """The share of the cells that are not empty."""
        return int(dr.count(self.occupied)[0]) / self.resolution**3

    def cell(self, place: mi.Point3f) -> mi.UInt32:
        """Number of the cell around a place in the cube; x varies fastest."""
        side = self.resolution
        place = dr.clip(place * side, 0, side - 1)
        return mi.UInt32(place.x) + side * (mi.UInt32(place.y) + side * mi.UInt32(place.z))

"""Hash grids and small networks on Dr.Jit: what the learned systems are made of.

A multiresolution hash grid (Müller and others 2022) turns a point of the unit cube into features:
on each of its levels the features of the eight corners of the cell around the point are
interpolated, and those of all levels are joined. A small fully connected network makes an answer of
them.

Parameters are flat float32 arrays, which the caller owns, changes and hands back with ``update``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import drjit.nn as nn
import mitsuba as mi
import numpy as np

# Features start between plus and minus this.
INITIAL_FEATURE = 1e-4


@dataclass(frozen=True)
class GridShape:
    """Sizes of a hash grid.

    Attributes
    ----------
    levels: grids of different resolution.
    features: numbers per grid vertex; a multiple of 2.
    log2_entries: each level has at most 2 to the power of this many vertices of its own; those of
        a finer one share them, by a hash of their place.
    coarsest, finest: vertices along an edge of the cube on the first and on the last level.
    """

    levels: int
    features: int
    log2_entries: int
    coarsest: int
    finest: int

    @property
    def outputs(self) -> int:
        """Features of a point."""
        return self.levels * self.features


class HashGrid:
    """Features of points in the unit cube."""

    def __init__(self, shape: GridShape, seed: int) -> None:
        self.shape = shape
        growth = (shape.finest / shape.coarsest) ** (1 / max(shape.levels - 1, 1))
        self._encoding = nn.HashGridEncoding(
            mi.Float,
            3,
            n_levels=shape.levels,
            n_features_per_level=shape.features,
            hashmap_size=1 << shape.log2_entries,
            base_resolution=shape.coarsest,
            per_level_scale=growth,
            init_scale=INITIAL_FEATURE,
            rng=dr.rng(seed),
        )
        self.parameters = mi.Float(self._encoding.data)
        dr.eval(self.parameters)

    def update(self, parameters: mi.Float) -> None:
        """Take other parameters of the same number."""
        self.parameters = parameters
        self._encoding.data = parameters

    def __call__(self, place: mi.Point3f, active: mi.Bool | bool = True) -> list[mi.Float]:
        """Features at places in [0, 1]³, one array (N,) each."""
        return list(self._encoding(list(place), active))


class Network:
    """A fully connected network: leaky rectifiers between its layers, nothing after the last.

    It runs on cooperative vectors, in half precision on CUDA, where Dr.Jit offers no other. A
    gradient is small there: scale the loss so that a sample's does not vanish.
    """

    def __init__(self, inputs: int, hidden: Sequence[int], outputs: int, seed: int) -> None:
        layers: list[nn.Module] = []
        for width in hidden:
            layers += [nn.Linear(-1, width), nn.LeakyReLU()]
        model = nn.Sequential(*layers, nn.Linear(-1, outputs))
        self._number = mi.Float16 if dr.backend_v(mi.Float) == dr.JitBackend.CUDA else mi.Float
        model = model.alloc(dr.tensor_t(self._number), inputs, rng=dr.rng(seed))
        self._model = nn.pack(model, layout="training")
        self.parameters = mi.Float(self._model["weights"])
        dr.eval(self.parameters)

    def update(self, parameters: mi.Float) -> None:
        """Take other parameters of the same number."""
        self.parameters = parameters
        self._model["weights"] = self._number(parameters)

    def __call__(self, inputs: Sequence[mi.Float]) -> list[mi.Float]:
        """Answers, one array (N,) for each output."""
        vector = nn.CoopVec(*(self._number(value) for value in inputs))
        return [mi.Float(value) for value in self._model(vector)]


@dataclass(frozen=True)
class Cube:
    """The cube that a hash grid covers.

    Attributes
    ----------
    corner: its lower corner, world units.
    edge: its edge, world units.
    """

    corner: tuple[float, float, float]
    edge: float

    @classmethod
    def around(cls, box: np.ndarray, margin: float) -> Cube:
        """The smallest cube around a box (2, 3), larger by ``margin`` of it on each side."""
        edge = float((box[1] - box[0]).max()) * (1 + 2 * margin)
        x, y, z = (box.mean(axis=0) - edge / 2).tolist()
        return cls((x, y, z), edge)

    def place(self, p: mi.Point3f) -> mi.Point3f:
        """Points of the world in coordinates of the cube, [0, 1]³ inside."""
        return (p - mi.Point3f(*self.corner)) * (1 / self.edge)

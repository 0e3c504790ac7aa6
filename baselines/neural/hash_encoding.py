"""Hash grids and small networks on Dr.Jit, for the learned systems.

A multiresolution hash grid (Müller and others 2022) encodes a point of the unit cube as features.
Each level interpolates the features of the eight corners of the cell around the point; the features
of all levels together are the input of a small fully connected network.

Parameters are flat float32 arrays. The caller optimises them and sets them with ``update``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import drjit.nn as nn
import mitsuba as mi
import numpy as np

# Initial features are random between plus and minus this.
INITIAL_FEATURE = 1e-4


@dataclass(frozen=True)
class GridShape:
    """Sizes of a hash grid.

    Attributes
    ----------
    levels: number of grids with different resolutions.
    features: features per vertex; a multiple of 2.
    log2_entries: each level stores at most 2 to this power vertices; a finer level's vertices share
        entries by a hash of their position.
    coarsest, finest: vertices along the cube's edge on the first and the last level.
    """

    levels: int
    features: int
    log2_entries: int
    coarsest: int
    finest: int

    @property
    def outputs(self) -> int:
        """The number of features of a point."""
        return self.levels * self.features


class HashGrid:
    """A hash grid: features of points in the unit cube."""

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
        """Replace the parameters with an array of the same size."""
        self.parameters = parameters
        self._encoding.data = parameters

    def __call__(self, place: mi.Point3f, active: mi.Bool | bool = True) -> list[mi.Float]:
        """Features at places in [0, 1]³, one array (N,) each."""
        return list(self._encoding(list(place), active))


class Network:
    """A fully connected network with leaky rectifiers between its layers, none after the last.

    It runs on cooperative vectors: on CUDA in half precision, since Dr.Jit offers no other there.
    Small gradients then underflow: scale the loss so that a sample's gradient does not vanish.
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
        """Replace the parameters with an array of the same size."""
        self.parameters = parameters
        self._model["weights"] = self._number(parameters)

    def __call__(self, inputs: Sequence[mi.Float]) -> list[mi.Float]:
        """The outputs, one array (N,) each."""
        vector = nn.CoopVec(*(self._number(value) for value in inputs))
        return [mi.Float(value) for value in self._model(vector)]


@dataclass(frozen=True)
class Cube:
    """The cube that a hash grid covers.

    Attributes
    ----------
    corner: lower corner, world units.
    edge: length of the edges, world units.
    """

    corner: tuple[float, float, float]
    edge: float

    @classmethod
    def around(cls, box: np.ndarray, margin: float) -> Cube:
        """The smallest cube around a box (2, 3), enlarged by the share ``margin`` on each side."""
        edge = float((box[1] - box[0]).max()) * (1 + 2 * margin)
        x, y, z = (box.mean(axis=0) - edge / 2).tolist()
        return cls((x, y, z), edge)

    def place(self, p: mi.Point3f) -> mi.Point3f:
        """Coordinates of world points in the cube; points inside are in [0, 1]³."""
        return (p - mi.Point3f(*self.corner)) * (1 / self.edge)

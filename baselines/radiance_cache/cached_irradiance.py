"""A network for the irradiance on surfaces, and its fit to supervised points."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from baselines.neural.fitting import Fit, Recorded, given, run_steps
from baselines.neural.hash_encoding import Cube, GridShape, HashGrid, Network
from gpf.core.random import stratified_batch
from gpf.core.structs import SurfacePoints, from_numpy, take
from gpf.training.loss import relative_weight
from gpf.training.settings import cosine_decay


@dataclass(frozen=True)
class CacheShape:
    """Sizes of the network.

    Attributes
    ----------
    grid: encoding of the position.
    hidden: widths of the network's hidden layers.
    """

    grid: GridShape
    hidden: tuple[int, ...]


# A position is moved along its normal by this fraction of the cube's edge before it is encoded, so
# that surfaces in a corner and the two sides of a thin wall fall into different cells.
OFFSET = 0.01


class CachedIrradiance:
    """E(x, n) = u exp f(γ(x), n): a hash grid γ, a small network f, and a unit u.

    The exponential suits a quantity that spans some five orders of magnitude and is never negative.

    Parameters
    ----------
    cube: the cube that the grid covers.
    unit: u, W/m²; about the output of an untrained network.
    """

    def __init__(self, shape: CacheShape, cube: Cube, unit: float, seed: int) -> None:
        self.cube, self.unit = cube, unit
        self.grid = HashGrid(shape.grid, seed)
        self.network = Network(shape.grid.outputs + 3, shape.hidden, 3, seed + 1)

    @property
    def parameters(self) -> list[mi.Float]:
        """The grid's features and the network's weights."""
        return [self.grid.parameters, self.network.parameters]

    def update(self, parameters: list[mi.Float]) -> None:
        """Replace the parameters."""
        self.grid.update(parameters[0])
        self.network.update(parameters[1])

    def relative(self, p: mi.Point3f, n: mi.Normal3f) -> mi.Color3f:
        """E / u at surface points with normals ``n``, (N, 3)."""
        place = self.cube.place(p) + OFFSET * n
        answer = self.network([*self.grid(mi.Point3f(place)), *n])
        return mi.Color3f(*(dr.exp(value) for value in answer))

    def irradiance(self, p: mi.Point3f, n: mi.Normal3f) -> mi.Color3f:
        """E in W/m², (N, 3)."""
        return self.relative(p, n) * dr.opaque(mi.Float, self.unit)


@dataclass(frozen=True)
class CacheTraining:
    """How the network is fitted.

    Attributes
    ----------
    steps: optimiser steps.
    batch: supervised points per step.
    rate: Adam's initial rate; it decays to ``final_rate`` times that along a cosine.
    shrink: weight decay of the grid's features per step, in units of the rate.
    held_out: fraction of the points that are not trained on; they give the held-out error.
    seed: random seed of the split and the batches.
    """

    steps: int = 500
    batch: int = 32_768
    rate: float = 4e-2
    final_rate: float = 0.03
    shrink: float = 1.0
    held_out: float = 0.1
    seed: int = 0


class CacheTrainer:
    """Fits a :class:`CachedIrradiance` by relative squared errors (:mod:`gpf.training.loss`)."""

    def __init__(
        self, model: CachedIrradiance, points: SurfacePoints, settings: CacheTraining
    ) -> None:
        self.model, self.settings = model, settings
        rng = np.random.default_rng(settings.seed)
        judges = rng.random(dr.width(points.p)) < settings.held_out
        rows = [from_numpy(mi.UInt32, np.flatnonzero(s)) for s in (~judges, judges)]
        self.training, self.held_out = (take(points, chosen) for chosen in rows)
        for part in (self.training, self.held_out):
            part.target /= dr.opaque(mi.Float, model.unit)
            dr.eval(part)
        self.fit = Fit(model.parameters)
        self._gradients = Recorded(self._trace_gradients)

    def run(
        self,
        checkpoint: Path,
        fingerprint: Mapping[str, Any],
        report: Callable[[int, int], None] = lambda done, total: None,
    ) -> None:
        """Run all remaining steps; the model holds the result.

        Continues from a checkpoint with the same fingerprint.
        """
        self.fit.restore(checkpoint, fingerprint)

        def save() -> None:
            self.fit.save(checkpoint, fingerprint)

        run_steps(self.fit, self.settings.steps, self.step, save, report)
        self.model.update(self.fit.values)

    def step(self) -> mi.Float:
        """Run one optimiser step; returns the weighted squared errors of its batch, (B,)."""
        s, fit = self.settings, self.fit
        number = dr.opaque(mi.UInt32, fit.step)
        seed = dr.opaque(mi.UInt32, s.seed)
        *gradients, errors = self._gradients(*fit.values, self.training, seed, number)
        rate = dr.opaque(mi.Float, s.rate * cosine_decay(fit.step / s.steps, s.final_rate))
        values = fit.adam.step(fit.values, gradients, [rate, rate], fit.step + 1)
        values[0] -= rate * s.shrink * fit.values[0]
        dr.eval(values, fit.adam.first, fit.adam.second)
        fit.values, fit.step = values, fit.step + 1
        return errors

    def _trace_gradients(
        self,
        table: mi.Float,
        weights: mi.Float,
        points: SurfacePoints,
        seed: mi.UInt32,
        number: mi.UInt32,
    ) -> tuple[mi.Float, mi.Float, mi.Float]:
        """Gradients of a batch's summed error for both parameter arrays, and the errors, (B,)."""
        table, weights = dr.detach(table), dr.detach(weights)  # leaves the caller's unchanged
        dr.enable_grad(table, weights)
        chosen = stratified_batch(dr.width(points.p), self.settings.batch, seed, number)
        p, n = dr.gather(mi.Point3f, points.p, chosen), dr.gather(mi.Normal3f, points.n, chosen)
        with given(self.model, [table, weights]):
            found = self.model.relative(p, n)
        difference = found - dr.gather(mi.Color3f, points.target, chosen)
        errors = relative_weight(dr.mean(dr.detach(found))) * dr.squared_norm(difference)
        dr.backward(errors)
        result = dr.grad(table), dr.grad(weights), dr.detach(errors)
        dr.eval(result)
        return result

    def held_out_error(self) -> float:
        """Root mean square error on the held-out points, in units of u; 0 if there are none."""
        points = self.held_out
        if dr.width(points.p) == 0:
            return 0.0
        with dr.suspend_grad():
            value = self.model.relative(points.p, points.n)
            error = relative_weight(dr.mean(value)) * dr.squared_norm(value - points.target)
        return float(np.sqrt(dr.mean(error)[0] / 3))

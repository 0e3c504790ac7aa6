"""Training: Adam on batches of supervised points.

A step is two kernels. The first runs over Gaussians: it applies Adam to the last gradients and
writes the arrays that the second reads. The second runs over a batch of points: it blends each
point's neighbours, compares the blend with the target, visits the neighbours again and adds their
gradients.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.errors import UserError
from gpf.core.morton import order_in_space
from gpf.core.random import stratified_batch
from gpf.core.structs import SurfacePoints, from_numpy, take, to_numpy
from gpf.field.field import GaussianPhotonField
from gpf.field.gaussians import Gaussians
from gpf.training.adam import Adam
from gpf.training.kernels import (
    accumulate_gradients,
    blend_neighbours,
    pack,
    parameters,
    unpack_gradients,
    with_parameters,
    zero_gradients,
)
from gpf.training.loss import relative_weight
from gpf.training.neighbours import list_neighbours, local_targets
from gpf.training.settings import TrainingSettings, cosine_decay


@dataclass(frozen=True)
class Progress:
    """State of the training after ``step`` steps: root mean square errors of the last batch and of
    the held-out points, and the smallest of the latter so far; in units of the mean target, with
    the weights of the loss."""

    step: int
    training_error: float
    held_out_error: float
    best_error: float


# Smallest brightness, in units of the mean target, that scales the learning rate of a Gaussian's
# irradiance.
LEAST_LEVEL = 0.01


class Trainer:
    """Fits a field to supervised points.

    :meth:`finish` gives the field its best state.

    Parameters
    ----------
    field: the field before training.
    points: supervised points, (P); they are copied and sorted by position.
    from_targets: whether each Gaussian's irradiance starts as the mean of the nearest targets
        instead of the field's value.
    anisotropic: whether the three scales of a Gaussian may differ.
    """

    def __init__(
        self,
        field: GaussianPhotonField,
        points: SurfacePoints,
        settings: TrainingSettings,
        from_targets: bool = True,
        anisotropic: bool = True,
    ) -> None:
        self.field, self.settings, self.anisotropic = field, settings, anisotropic
        points = replace(points, p=field.unfold(points.p))
        count = dr.width(points.p)
        rng = np.random.default_rng(settings.seed)
        split = rng.random(count) < settings.held_out
        # Sorted by position, so that batches are spread evenly over the surfaces and neighbouring
        # lanes read the same Gaussians.
        order = order_in_space(to_numpy(points.p), field.settings.search_radius / 2)
        sets = (order[~split[order]], order[split[order]])
        self.training, self.held_out = (take(points, from_numpy(mi.UInt32, s)) for s in sets)

        mean_target = np.mean(np.asarray(self.training.target.numpy()))
        self.unit = float(mean_target) if mean_target > 0 else 1.0
        for part in (self.training, self.held_out):
            if dr.width(part.p) > 0:
                part.target /= dr.opaque(mi.Float, self.unit)
                dr.eval(part)

        g = field.gaussians
        around = local_targets(g, self.training, field.settings.search_radius, field.limits)
        irradiance = g.irradiance / self.unit
        if from_targets:
            irradiance = from_numpy(mi.Color3f, around)
        self.gaussians = replace(g, irradiance=irradiance)
        # The size of Adam's steps depends on the rate, not on the gradient. With one rate for all,
        # steps suited to bright Gaussians would be too large for dark ones.
        level = around.mean(axis=1) if mean_target > 0 else np.ones(len(around))
        self.level = from_numpy(mi.Float, np.maximum(level, LEAST_LEVEL))
        size = dr.width(g.means)
        self.adam = Adam(
            [dr.zeros(mi.Float, size) for _ in parameters(g)],
            [dr.zeros(mi.Float, size) for _ in parameters(g)],
        )
        self.step_count = 0
        self.batch_errors = mi.Float(0)
        self.best_error = float("inf")
        self.history: list[Progress] = []
        self.best = self.gaussians
        self.rebuild()
        self.held_out_weight = self._weigh_held_out()

    def rebuild(self) -> None:
        """Rebuild the neighbour search and the neighbour lists of all points."""
        self.rebuilt_at = self.step_count
        self.field.update(self.gaussians)
        self.lists = list_neighbours(self.field, self.training)
        if dr.width(self.held_out.p) > 0:
            self.held_out_lists = list_neighbours(self.field, self.held_out)

    def _weigh_held_out(self) -> mi.Float:
        """Weights of the held-out points, (H,): those of the loss before the first step. With the
        weights of each state, bright states would seem better."""
        if self.settings.loss == "squared" or dr.width(self.held_out.p) == 0:
            return mi.Float(1)
        weight = relative_weight(dr.sum(self._blend_held_out()) / 3)
        dr.eval(weight)
        return weight

    def _blend_held_out(self) -> mi.Color3f:
        """The field's answers at the held-out points, (H, 3)."""
        every = dr.arange(mi.UInt32, dr.width(self.held_out.p))
        divided = self.field.settings.blend == "divided"
        packets = pack(self.gaussians)
        dr.eval(packets)
        return blend_neighbours(self.held_out, self.held_out_lists, every, packets, divided)[0]

    def rates(self) -> list[mi.Float]:
        """Learning rates of this step, one array per parameter, scaled by :func:`cosine_decay`."""
        s = self.settings
        decay = cosine_decay(self.step_count / max(s.steps, 1), s.final_rate)
        r = s.rates
        unit = self.field.settings.search_radius
        values = [r.means * unit] * 3 + [r.log_scales] * 3 + [r.quats] * 4
        common = [dr.opaque(mi.Float, v * decay) for v in values]
        irradiance = dr.opaque(mi.Float, r.irradiance * decay) * self.level
        return [*common, irradiance, irradiance, irradiance]

    def step(self) -> mi.Float:
        """Take one optimiser step; return the squared errors of its batch, (B,)."""
        size = dr.width(self.gaussians.means)
        packets = pack(self.gaussians)
        gradients = zero_gradients(size)
        chosen = self.batch()
        scale = dr.opaque(mi.Float, 1 / (3 * dr.width(chosen)))
        divided = self.field.settings.blend == "divided"
        dr.eval(packets)
        errors = accumulate_gradients(
            self.training,
            self.lists,
            chosen,
            packets,
            gradients,
            scale,
            divided,
            self.settings.loss,
        )
        dr.eval(errors, gradients)
        values = self.adam.step(
            parameters(self.gaussians),
            unpack_gradients(self.gaussians, gradients, self.anisotropic),
            self.rates(),
            self.step_count + 1,
        )
        self.gaussians = with_parameters(self.gaussians, values)
        # Beside bright places, negative values would show as black spots.
        self.gaussians.irradiance = dr.maximum(self.gaussians.irradiance, 0)
        dr.eval(self.gaussians, self.adam.first, self.adam.second)
        self.step_count += 1
        self.batch_errors = errors
        return errors

    def batch(self) -> mi.UInt32:
        """The points of this step, (B,): spread evenly over the surfaces, because the points are
        sorted by position."""
        # Opaque: values that change with each step must not become constants of the kernel.
        seed, step = (dr.opaque(mi.UInt32, v) for v in (self.settings.seed, self.step_count))
        return stratified_batch(dr.width(self.training.p), self.settings.batch, seed, step)

    def evaluate(self) -> float:
        """Root mean square error at the held-out points, with the weights of the loss, in units of
        the mean target; 0 without held-out points."""
        if dr.width(self.held_out.p) == 0:
            return 0.0
        difference = self._blend_held_out() - self.held_out.target
        error = self.held_out_weight * dr.squared_norm(difference)
        return float(np.sqrt(dr.mean(error)[0] / 3))

    def advance(self, steps: int) -> None:
        """Take ``steps`` steps, with rebuilds when they are due."""
        for _ in range(steps):
            self.step()
            if self.step_count % self.settings.rebuild_every == 0:
                self.rebuild()

    def run(self) -> GaussianPhotonField:
        """Train to the end and return the field in its best state.

        Raises
        ------
        UserError: the error was never finite.
        """
        for _ in self.steps():
            pass
        return self.finish()

    def steps(self) -> Iterator[Progress | None]:
        """Take all remaining steps, one at a time; yields the evaluation where one is due."""
        s = self.settings
        while self.step_count < s.steps:
            self.advance(1)
            due = self.step_count % s.evaluate_every == 0 or self.step_count == s.steps
            yield self.judge() if due else None

    def judge(self) -> Progress:
        """Evaluate the current state, and keep it if it is the best so far."""
        if self.step_count % self.settings.rebuild_every != 0:
            # With fresh lists, because the renderer will also query the current Gaussians.
            self.rebuild()
        held_out = self.evaluate()
        if held_out <= self.best_error:  # without held-out points, always the last state
            self.best_error, self.best = held_out, self.gaussians
        training = float(np.sqrt(dr.mean(self.batch_errors)[0] / 3))
        self.history.append(Progress(self.step_count, training, held_out, self.best_error))
        return self.history[-1]

    def finish(self) -> GaussianPhotonField:
        """The field in its best state."""
        if self.history and not np.isfinite(self.best_error):
            raise UserError(
                "training",
                "diverged: the error at the held-out points was never finite",
                "Check the targets, or lower the learning rates.",
            )
        return self.current_field(self.best)

    def current_field(self, state: Gaussians | None = None) -> GaussianPhotonField:
        """The field with the given state of its Gaussians, by default the state after the last
        step."""
        state = state or self.gaussians
        self.field.update(replace(state, irradiance=state.irradiance * self.unit))
        return self.field

"""Training: steps of a field's Gaussians, and which of their states to keep."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.errors import UserError
from gpf.core.morton import order_in_space
from gpf.core.structs import SurfacePoints, from_numpy, take, to_numpy
from gpf.field.field import GaussianPhotonField
from gpf.field.gaussians import Gaussians
from gpf.training.descent import GaussianDescent
from gpf.training.held_out import HeldOut
from gpf.training.neighbours import local_targets
from gpf.training.settings import TrainingSettings


@dataclass(frozen=True)
class Progress:
    """State of the training after ``step`` steps: root mean square errors of the last batch and of
    the held-out points, and the smallest of the latter so far; in units of the mean target, with
    the weights of the loss."""

    step: int
    training_error: float
    held_out_error: float
    best_error: float


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
        self.field, self.settings = field, settings
        points = replace(points, p=field.unfold(points.p))
        count = dr.width(points.p)
        rng = np.random.default_rng(settings.seed)
        split = rng.random(count) < settings.held_out
        # Sorted by position, so that batches are spread evenly over the surfaces and neighbouring
        # lanes read the same Gaussians.
        order = order_in_space(to_numpy(points.p), field.settings.search_radius / 2)
        sets = (order[~split[order]], order[split[order]])
        training, held_out = (take(points, from_numpy(mi.UInt32, s)) for s in sets)

        mean_target = np.mean(np.asarray(training.target.numpy()))
        self.unit = float(mean_target) if mean_target > 0 else 1.0
        for part in (training, held_out):
            if dr.width(part.p) > 0:
                part.target /= dr.opaque(mi.Float, self.unit)
                dr.eval(part)

        g = field.gaussians
        around = local_targets(g, training, field.settings.search_radius, field.limits)
        irradiance = g.irradiance / self.unit
        if from_targets:
            irradiance = from_numpy(mi.Color3f, around)
        self.gaussians = replace(g, irradiance=irradiance)
        level = around.mean(axis=1) if mean_target > 0 else np.ones(len(around))
        self.descent = GaussianDescent(field, training, settings, level, anisotropic)
        self.held_out = HeldOut(field, held_out)
        self.step_count = 0
        self.batch_errors = mi.Float(0)
        self.history: list[Progress] = []
        self.best = self.gaussians
        self.rebuild()
        if settings.loss == "relative":
            self.held_out.weigh(self.gaussians)

    @property
    def best_error(self) -> float:
        """The smallest error at the held-out points so far."""
        return self.history[-1].best_error if self.history else float("inf")

    def rebuild(self) -> None:
        """Rebuild the neighbour search and the neighbour lists of all points."""
        self.rebuilt_at = self.step_count
        self.field.update(self.gaussians)
        self.descent.rebuild()
        self.held_out.rebuild()

    def evaluate(self) -> float:
        """Root mean square error at the held-out points, with the weights of the loss, in units of
        the mean target; 0 without held-out points."""
        return self.held_out.error(self.gaussians)

    def advance(self, steps: int) -> None:
        """Take ``steps`` steps, with rebuilds when they are due."""
        for _ in range(steps):
            if self.step_count % self.settings.rebuild_every == 0:
                self._refresh()
            found = self.descent.step(self.gaussians, self.step_count)
            self.gaussians, self.batch_errors = found
            self.step_count += 1

    def _refresh(self) -> None:
        if self.rebuilt_at != self.step_count:
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
        if self.held_out:
            # With fresh lists, because the renderer will also query the current Gaussians.
            self._refresh()
        held_out, least = self.evaluate(), self.best_error
        if held_out <= least:  # without held-out points, always the last state
            least, self.best = held_out, self.gaussians
        training = float(np.sqrt(dr.mean(self.batch_errors)[0] / 3))
        self.history.append(Progress(self.step_count, training, held_out, least))
        return self.history[-1]

    def finish(self) -> GaussianPhotonField:
        """The field in its best state; that after the last step is judged, too."""
        if self.step_count > (self.history[-1].step if self.history else 0):  # ended early
            self.judge()
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

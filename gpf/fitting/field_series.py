"""The fields of a fit, each from more photons than the one before."""

from __future__ import annotations

import copy
import dataclasses
import logging
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from gpf.field.field import GaussianPhotonField
from gpf.fitting.best_field import MOST_STALLS, BestField
from gpf.fitting.field_maker import FieldMaker, Lesson
from gpf.fitting.goals import Goals, TimeBudget
from gpf.fitting.plan import (
    LARGEST_STRIDE,
    LEAST_STEPS,
    STEPS_PER_EVALUATION,
    FieldCost,
    Plan,
    plan_next,
)
from gpf.fitting.progress import Reporter
from gpf.fitting.quality import ENOUGH_PASSES, LEAST_PASSES, QualityEstimate
from gpf.fitting.state import FitState, Resume
from gpf.training.half_colours import HalfColours
from gpf.training.settings import TrainingSettings
from gpf.training.streaming import PhotonStream
from gpf.training.trainer import Trainer

# Passes for the field per pass for the PSNR estimate: the usual number, and the smallest, for when
# the estimate is too uncertain.
PASSES_PER_ESTIMATE, LEAST_PER_ESTIMATE = 8, 4

TRAINING = TrainingSettings(evaluate_every=STEPS_PER_EVALUATION)

log = logging.getLogger(__name__)


@dataclass
class FieldSeries:
    """Complete fields from more and more passes of the same stream.

    Attributes
    ----------
    origin: the scene, as :func:`gpf.fitting.opening.examine` gives it.
    maker: makes the fields.
    state: where photons are saved, or None.
    last: the plan of the last complete field; None before it.
    cost: what that field cost.
    """

    goals: Goals
    time: TimeBudget
    reporter: Reporter
    origin: dict[str, Any]
    maker: FieldMaker
    quality: QualityEstimate
    best: BestField = dataclasses.field(default_factory=BestField)
    state: FitState | None = None
    last: Plan | None = None
    cost: FieldCost = dataclasses.field(default_factory=FieldCost)

    @property
    def stream(self) -> PhotonStream:
        """The photons."""
        return self.maker.stream

    def run(self) -> None:
        """Make fields until a goal is reached, or until no better field can follow."""
        while not self.is_done() and (plan := self.trace()):
            self.stream.sample()  # its time is not part of the field's cost
            self.save()
            self.make_field(plan)
            dr.flush_malloc_cache()  # Dr.Jit would keep the training's memory, a gigabyte or more
            self.gather()

    def is_done(self) -> bool:
        """Whether a goal is reached, or can no longer be reached."""
        target, psnr = self.goals.target_psnr, self.best.psnr
        if psnr is None or self.last is None or self.last.is_draft:
            return False
        if target is not None and psnr >= target:
            return True
        if target is not None and self.best.stalls >= MOST_STALLS:
            words = "More passes will not raise the estimated PSNR from %.1f dB to %.1f dB."
            log.warning(words, psnr, target)
            return True
        return self.plan() is None

    def plan(self) -> Plan | None:
        """Plan the next field."""
        pass_seconds = self.time.pass_seconds * (1 + 1 / PASSES_PER_ESTIMATE)
        times = self.time.left, pass_seconds
        done, gathers = self.stream.count, self.stream.gathered is not None
        return plan_next(done, self.last, self.goals.passes, *times, self.cost, gathers)

    def trace(self) -> Plan | None:
        """Trace the photons of the next field; None if no time is left for one."""
        self.time.start_pass()
        while (plan := self.plan()) and self.stream.count < plan.passes:
            self.reporter.note(all_passes=plan.passes, all_steps=plan.steps)
            # A few samples of lamps are enough for a draft: light gathered from it is as good.
            self.stream.advance(self.stream.count + 1, balances=self.last is not None)
            self.time.note_pass()
            if self.quality.passes < self.stream.count / PASSES_PER_ESTIMATE:
                self.quality.add_pass()
            if self.state is not None and self.state.is_due():
                self.save()
            self.time.start_pass()
            self.tell()
            # A draft is always followed by another field.
            is_draft = self.last is not None and self.last.is_draft
            if self.best.field is not None and not is_draft and self.time.is_over():
                return None
        return plan

    def make_field(self, plan: Plan) -> None:
        """Fit a field to the passes so far, judge it, and measure what it costs."""
        self.reporter.note(all_passes=plan.passes, all_steps=plan.steps)
        begin = self.time.work
        lesson = self.maker.supervise(plan.stride)
        trainer = self.maker.start(lesson, plan.steps)
        start = self.time.work
        step, evaluation = self.train(trainer)
        trained = self.time.work
        field = trainer.finish()
        fitted = self.maker.clean(field, lesson, plan.steps)
        cleaned = self.time.work
        if plan.is_draft:
            self.maker.add_error(field, fitted)
            self.take(field, lesson, None)
        else:
            self.judge(field, fitted, lesson)
        # Not earlier: an interrupted field has to be fitted again.
        self.last = dataclasses.replace(plan, passes=self.stream.count)
        self.tell(self.best.field)
        cleaning, judgement = cleaned - trained, self.time.work - cleaned
        of_points = start - begin + cleaning
        if plan.is_draft:  # the next field has more Gaussians, and is judged
            cleaning, judgement = 2 * cleaning, (LEAST_PASSES + 1) * self.time.pass_seconds
        all_points = plan.stride * of_points, plan.stride * evaluation
        self.cost = FieldCost(*all_points, step, judgement, cleaning + judgement)

    def train(self, trainer: Trainer) -> tuple[float, float]:
        """Train to the end, or while there is time; returns the seconds of a step and of an
        evaluation."""
        ticks = [self.time.work]
        for progress in trainer.steps():
            if progress:
                self.reporter.note(held_out_error=progress.held_out_error)
                # A copy: later steps change the trainer's field, and the unit of its colours.
                field = copy.copy(trainer.current_field())
                field.record = self.origin_of(self.stream.count)
                self.tell(field)
            dr.sync_thread()  # or the next evaluation would include the time of the steps
            ticks.append(self.time.work)
            self.reporter.note(steps=trainer.step_count)
            self.tell()
            # Not before any training: all the photons of the last field would be wasted.
            trained = trainer.step_count >= STEPS_PER_EVALUATION
            if trained and self.best.field is not None and self.time.is_over(self.cost.ending):
                break
        intervals = np.diff(ticks)
        step = float(np.median(intervals))
        return step, max(float(intervals[-1]) - step, 0)  # the last step ends with an evaluation

    def judge(self, field: GaussianPhotonField, fitted: HalfColours, lesson: Lesson) -> None:
        """Estimate the PSNR of a field, and keep it unless its training failed.

        Parameters
        ----------
        fitted: what the field would be from each half of the photons.
        lesson: what it has learned from.
        """
        self.add_estimates(ENOUGH_PASSES)
        most = self.stream.count // LEAST_PER_ESTIMATE
        self.add_estimates(min(self.quality.needed_passes(field), most))
        psnr = self.quality.psnr(field)
        was_draft = self.last is not None and self.last.is_draft
        if self.best.gives_way_to(psnr, self.quality, was_draft):
            self.add_error(field, fitted)
            self.take(field, lesson, psnr)

    def take(self, field: GaussianPhotonField, lesson: Lesson, psnr: float | None) -> None:
        """Keep a field, with its estimated PSNR unless it is a draft."""
        self.maker.split(field, lesson)
        field.record = self.origin_of(self.stream.count)
        self.best.take(field, self.stream.count, psnr)

    def add_error(self, field: GaussianPhotonField, fitted: HalfColours) -> None:
        """Give a field its expected errors."""
        error = self.maker.add_error(field, fitted)
        field.set_error(error * np.float32(self.quality.error_scale(field)))

    def add_estimates(self, wanted: int) -> None:
        """Add passes for the estimate: :data:`LEAST_PASSES` in any case, more while there is
        time."""
        while self.quality.passes < wanted and (
            self.quality.passes < LEAST_PASSES or not self.time.is_over()
        ):
            self.quality.add_pass()

    def gather(self) -> None:
        """Gather diffuse light from the best field, if another one follows."""
        assert self.best.field is not None and self.last is not None
        if not self.last.is_draft:
            if self.last.passes >= self.goals.passes and self.last.gathered:
                return
            if self.time.left < self.cost.seconds(LEAST_STEPS, LARGEST_STRIDE):
                return
        before = self.stream.sample_seconds
        self.stream.light_by(self.best.field)
        self.time.lengthen_passes(self.stream.sample_seconds - before)

    def resume(self, state: FitState, resume: Resume) -> None:
        """Continue from what was saved, if anything was."""
        self.state = state
        tensors, facts, fields = state.load(resume)
        if not tensors:
            return
        self.stream.restore(tensors, fields.get("gathering"))
        self.quality.restore(tensors)
        self.last = Plan(*facts["last"]) if facts["last"] else None
        self.time.pass_seconds, *cost = facts["seconds"]
        self.cost = FieldCost(*cost)
        if best := fields.get("best"):
            self.best.restore(best, facts, self.quality)
            if facts["target_psnr"] != self.goals.target_psnr:
                self.best.stalls = 0
            # Interrupted earlier, or the fit was at its end.
            if self.last is not None and self.stream.gathering is not best:
                self.gather()

    def save(self) -> None:
        """Write the state, if there is a folder for it."""
        if self.state is not None:
            facts = self.best.facts() | {
                "last": dataclasses.astuple(self.last) if self.last else None,
                "target_psnr": self.goals.target_psnr,
                "seconds": [self.time.pass_seconds, *dataclasses.astuple(self.cost)],
            }
            tensors = self.stream.tensors() | self.quality.tensors()
            fields = {"best": self.best.field, "gathering": self.stream.gathering}
            self.state.save(tensors, facts, {k: v for k, v in fields.items() if v is not None})

    def result(self) -> GaussianPhotonField:
        """The best field with its record."""
        field = self.best.field
        assert field is not None
        if (psnr := self.best.psnr) is None:  # a draft, for the fit was interrupted
            self.save()
            self.add_estimates(LEAST_PASSES)
            psnr = self.best.judge_again(self.quality)
        field.record = self.origin_of(self.best.passes) | {
            "estimated_psnr": psnr,
            "fields": self.best.history,
            "exposure": self.quality.exposure,
            "seconds": self.time.spent,
            "seed": self.stream.seed,
        }
        self.save()
        return field

    def origin_of(self, passes: int) -> dict[str, Any]:
        """The record of a field from so many passes; a field that is shown may also be kept."""
        return {"passes": passes} | self.origin

    def tell(self, field: GaussianPhotonField | None = None) -> None:
        """Report the progress, with a field where there is a new one."""
        self.reporter.note(passes=self.stream.count, psnr=self.best.psnr)
        self.reporter.tell(self.time.spent, field)

"""``gpf.fit``: from a scene to a field, without any choices to make."""

from __future__ import annotations

import copy
import logging
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import astuple, dataclass, replace
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.errors import UserError, is_interrupt
from gpf.field.field import GaussianPhotonField
from gpf.field.initialization import InitialFieldSettings
from gpf.field.lights import FieldLights
from gpf.fitting.goals import Goals, TimeBudget, WorkClock
from gpf.fitting.plan import (
    LARGEST_STRIDE,
    LEAST_STEPS,
    STEPS_PER_EVALUATION,
    FieldCost,
    Plan,
    plan_next,
)
from gpf.fitting.quality import ENOUGH_PASSES, LEAST_PASSES, QualityEstimate
from gpf.fitting.state import FitState, Resume, fit_identity
from gpf.guiding.emission_plan import EmissionPlan, VisibleRegionSettings
from gpf.importing.placement import place_sensors
from gpf.scene.bounds import scene_bounds
from gpf.scene.fingerprint import fingerprint
from gpf.scene.inventory import check_scene, describe_media
from gpf.scene.light_groups import LightGroups
from gpf.sppm.reference import ReferenceSettings
from gpf.training.field_error import estimate_error
from gpf.training.half_colours import HalfColours
from gpf.training.light_split import split_light
from gpf.training.recipe import Recipe, open_stream
from gpf.training.settings import TrainingSettings
from gpf.training.shared_detail import keep_shared_detail
from gpf.training.streaming import PhotonStream, StreamSettings
from gpf.training.targets import Targets
from gpf.training.trainer import Progress, Trainer

# A PSNR is out of reach if tripling the passes gains less than this, dB, twice in a row.
LEAST_GAIN = 0.1

# A new field replaces the one before it unless its estimated PSNR is lower by more than this, dB.
# The estimate is uncertain, and a field from more photons is better unless its training failed.
TOLERATED = 3.0

# Passes for the field per pass for the PSNR estimate: the usual number, and the smallest, for when
# the estimate is too uncertain.
PASSES_PER_ESTIMATE, LEAST_PER_ESTIMATE = 8, 4

# Light is gathered for the next field if its first rays take at most this part of the time left.
GATHER_PART = 0.5

# Extra time for judging the last field, as a fraction of the fit's.
GRACE = 0.05

# A field whose estimated PSNR is below this, or this far below SPPM with the same passes (dB), has
# failed.
POOR, FAR_BELOW = 15.0, 6.0
FAILED = (
    "This field failed: its images have an estimated PSNR of %.1f dB; SPPM with %s passes would "
    "reach %.1f dB. Look at an image rendered from it. Fit longer, or with cameras that look at "
    "what matters (views.yaml). If that does not help, look for a lamp of extreme brightness or "
    "colour, or for a floor far larger than the part that is to be seen."
)

# Time between saved states while photons are traced.
SAVE_SECONDS = 60.0

FIELD = InitialFieldSettings(direct="auto")
STREAM = StreamSettings()
TRAINING = TrainingSettings(evaluate_every=STEPS_PER_EVALUATION)
REGION = VisibleRegionSettings(rays=131_072, pilot_paths=131_072)

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class FitProgress:
    """Progress of a fit.

    Attributes
    ----------
    passes, all_passes: photon passes so far, and planned in all.
    steps, all_steps: optimiser steps of the field in training, so far and in all.
    held_out_error: error at points that the training does not use, in units of the mean target;
        None before the first evaluation.
    psnr: estimated PSNR of the field's images against an SPPM reference with 1000 passes, dB; None
        before the first complete field.
    seconds: seconds since the start.
    field: the field so far, after each evaluation; otherwise None.
    """

    passes: int
    all_passes: int
    steps: int
    all_steps: int
    held_out_error: float | None
    psnr: float | None
    seconds: float
    field: GaussianPhotonField | None = None


def fit(
    scene: mi.Scene,
    sensors: Sequence[mi.Sensor] | None = None,
    *,
    seconds: float | None = None,
    target_psnr: float | None = None,
    passes: int | None = None,
    seed: int = 0,
    callback: Callable[[FitProgress], None] = lambda progress: None,
    state: Path | None = None,
    groups: LightGroups | None = None,
    exposure: float | None = None,
    resume: Resume = "if possible",
) -> GaussianPhotonField:
    """Fit a field to a scene.

    The fit stops when the first of its goals is reached or, without any goal, after
    :data:`gpf.fitting.goals.DEFAULT_PASSES` passes. It always completes a field from six passes, or
    from two if fewer are asked for, however long that takes. Interrupted by Ctrl-C, the fit returns
    the best field so far. The same seed and passes give the same bits on the same machine.

    Parameters
    ----------
    sensors: at least one camera that looks at what the field is for; by default cameras are placed
        around the scene's own, as ``gpf scene import`` does.
    seconds: wall-clock time for the whole fit.
    target_psnr: estimated PSNR of images against an SPPM reference with 1000 passes, dB.
    passes: photon passes.
    callback: called after each pass and each optimiser step.
    state: a folder in which the fit keeps its photons, some 100 MB. A later fit of the same scene
        with the same cameras, groups and seed continues with all of them.
    groups: groups of emitters whose light the field keeps apart (``field.lights``), so that each
        can be dimmed later.
    exposure: exposure of the images whose PSNR is estimated; by default one that suits them
        (:func:`gpf.core.images.propose_exposure`).
    resume: whether to continue from ``state``. ``always``: it is an error if the folder has no
        photons, or those of another fit; ``never``: replace what is there.

    Raises
    ------
    UserError: a goal is not above 0; the seed is not from 0 to 2³¹ - 1; the scene has no emitter or
        no diffuse surface, or a material that is not supported; there is no camera, or the cameras
        see no diffuse surface, or no light reaches those that they see; the light is not finite; or
        the fit cannot resume.
    """
    goals = Goals.of(seconds, target_psnr, passes)
    if not 0 <= seed < 2**31:
        raise UserError("seed", f"is {seed}", "Give a number from 0 to 2147483647.")
    if resume == "always" and state is None:
        raise UserError("resume", "needs a state folder", "Give the folder with the photons.")
    run = _Fit(scene, sensors, goals, seed, callback, state, groups, exposure)
    try:
        with run.clock:
            run.open(resume)
            while not run.is_done():
                run.fit_next()
            run.judge()
    except BaseException as error:
        if run.best is None or not (isinstance(error, _OutOfTime) or is_interrupt(error)):
            raise
        if not isinstance(error, _OutOfTime):
            log.warning("Interrupted: this is the field after %s passes.", run.passes)
    return run.result()


class _OutOfTime(Exception):
    """The time for the fit is up."""


class _Fit:
    """A fit in progress: complete fields from more and more passes of the same stream."""

    def __init__(
        self,
        scene: mi.Scene,
        sensors: Sequence[mi.Sensor] | None,
        goals: Goals,
        seed: int,
        callback: Callable[[FitProgress], None],
        state: Path | None,
        groups: LightGroups | None,
        exposure: float | None,
    ) -> None:
        check_scene(scene)
        if media := describe_media(scene):
            log.warning("scene: %s", media)
        self.goals = goals
        self.time, self.saved = TimeBudget(goals.seconds), time.perf_counter()
        self.clock = WorkClock()
        self.folder = None if state is None else Path(state)
        self.groups, self.exposure = groups, exposure
        self.state: FitState | None = None
        self.scene, self.seed, self.callback = scene, seed, callback
        # First: it evaluates parameters of the scene, and earlier kernels could not be reused.
        self.bounds, self.fingerprint = scene_bounds(scene), fingerprint(scene)
        self.sensors = list(place_sensors(scene) if sensors is None else sensors)
        if not self.sensors:
            raise UserError("sensors", "is empty", "Give a camera, or leave it out.")
        self.stream: PhotonStream
        self.halves: tuple[Targets, Targets] | None = None  # of the last field
        self.best: GaussianPhotonField | None = None
        self.passes, self.all_passes = 0, 0
        self.last: Plan | None = None  # of the last complete field
        self.cost, self.reserve = FieldCost(), 0.0
        self.history: list[tuple[int, float]] = []  # passes and estimated PSNR of the fields
        self.psnr: float | None = None
        self.in_vain = 0
        self.error: float | None = None
        self.steps, self.all_steps = 0, 0

    def open(self, resume: Resume) -> None:
        """Look around, choose the points, and continue from what was saved."""
        region = REGION.model_copy(update={"seed": self.seed})
        plan = EmissionPlan.make(self.scene, self.sensors, region)
        settings = ReferenceSettings(seed=self.seed).measure(self.scene, self.sensors[0], plan)
        recipe = Recipe(FIELD).suit(self.scene, settings)
        self.field_settings = recipe.field
        self.quality = QualityEstimate(
            self.scene,
            self.sensors,
            settings,
            self.field_settings,
            self.seed,
            plan.source,
            exposure=self.exposure,
        )
        named = {f"{k}": sensor for k, sensor in enumerate(self.sensors)}
        self.stream, self.photons = open_stream(
            self.scene,
            named,
            plan,
            settings,
            STREAM.model_copy(update={"seed": self.seed}),
            recipe,
            self.groups,
        )

        if self.folder is not None:
            parts = FIELD, REGION, STREAM, settings
            values = {"seed": self.seed, "settings": [part.model_dump() for part in parts]}
            if self.groups is not None:
                values["groups"] = [self.groups.names, self.groups.members]
            identity = fit_identity(self.scene, self.sensors, values)
            self.state = FitState(self.folder, identity)
            self._restore(*self.state.load(resume))

    def _restore(
        self,
        tensors: Mapping[str, np.ndarray],
        facts: Mapping[str, Any],
        best: GaussianPhotonField | None,
    ) -> None:
        """Continue from what was saved, if anything was."""
        if tensors:
            self.stream.restore(tensors, best)
            self.quality.restore(tensors)
            self.best, self.passes = best, facts["passes"]
            self.last = Plan(*facts["last"]) if facts["last"] else None
            if facts["target_psnr"] == self.goals.target_psnr:
                self.in_vain = facts["in_vain"]
            self.time.pass_seconds, *cost = facts["seconds"]
            self.cost = FieldCost(*cost)
            if best is not None:  # not the file's, which may be for another exposure
                self.psnr = self.quality.psnr(best)
                self.history = [(self.passes, self.psnr)]
                if self.last is not None and self.stream.gathered is None:  # interrupted earlier
                    self._light_by_best()

    def save(self) -> None:
        """Write the state, if there is a folder for it."""
        if self.state is not None:
            facts = {
                "passes": self.passes,
                "last": astuple(self.last) if self.last else None,
                "in_vain": self.in_vain,
                "target_psnr": self.goals.target_psnr,
                "seconds": [self.time.pass_seconds, *astuple(self.cost)],
            }
            self.state.save(self.stream.tensors() | self.quality.tensors(), facts, self.best)
            self.saved = time.perf_counter()

    def is_done(self) -> bool:
        """Whether a goal is reached, or can no longer be reached."""
        if self.best is None:
            return False
        if self.goals.target_psnr is not None and self.psnr is not None:
            if self.psnr >= self.goals.target_psnr:
                return True
            if self.in_vain >= 2:
                log.warning(
                    "More passes will not raise the estimated PSNR from %.1f dB to %.1f dB.",
                    self.psnr,
                    self.goals.target_psnr,
                )
                return True
        return self._plan() is None

    def fit_next(self) -> None:
        """Fit the next complete field, from more passes."""
        self.time.start_pass()
        while (plan := self._plan()) and self.stream.count < plan.passes:
            self.all_passes, self.all_steps = plan.passes, plan.steps
            self.stream.advance(self.stream.count + 1, self._count_pass)
        if plan is None:  # passes took longer than those before
            return
        self.all_passes, self.all_steps = plan.passes, plan.steps
        self.stream.sample()  # its time is not part of the field's cost
        self.save()
        self._fit_field(plan)
        dr.flush_malloc_cache()  # Dr.Jit would keep the training's memory, a gigabyte or more
        self._light_by_best()

    def _fit_field(self, plan: Plan) -> None:
        """Fit a field from the passes so far, judge it, and measure what it costs."""
        begin = self.clock.seconds()
        settings = TRAINING.model_copy(update={"seed": self.seed, "steps": plan.steps})
        recipe = Recipe(self.field_settings, settings)
        self.halves = self.stream.halves(plan.stride)
        trainer = recipe.fit_stream(self.stream, self.halves, self.photons, self.bounds)
        start = self.clock.seconds()
        ticks = [start]

        def count_step(steps: int) -> None:
            dr.sync_thread()  # or the next evaluation would include the time of the steps
            ticks.append(self.clock.seconds())
            self._count_step(steps)

        with suppress(_OutOfTime):
            trainer.run(lambda progress: self._report(trainer, progress), count_step)
        trained = self.clock.seconds()
        intervals = np.diff(ticks)
        step = float(np.median(intervals))
        evaluation = max(float(intervals[-1]) - step, 0)  # after the last step
        field = trainer.finish()
        fitted = self.fit_halves(field)
        field.recolour(keep_shared_detail(field, fitted))
        cleaned = self.clock.seconds()
        # A first field is soon replaced, but a PSNR that is compared with a target must be certain.
        first = self.best is None and self.goals.target_psnr is None
        self._add_estimates(LEAST_PASSES if first else ENOUGH_PASSES)
        self.quality.psnr(field)
        # The first estimate has prepared what later ones reuse.
        begin_judgement = self.clock.seconds()
        self.evaluate(field, fitted)
        # Not earlier: an interrupted field has to be fitted again.
        self.last = replace(plan, passes=self.stream.count)
        self._tell(self.best)
        now = self.clock.seconds()
        self.reserve = cleaned - trained + now - begin_judgement
        points = start - begin + cleaned - trained
        self.cost = FieldCost.of_all(plan.stride, points, evaluation, step, now - begin_judgement)

    def _light_by_best(self) -> None:
        """Gather diffuse light from the best field, if time is left for a better one."""
        assert self.best is not None and self.last is not None
        if self.last.passes >= self.goals.passes and self.last.gathered and not self.last.is_draft:
            return
        left, before = self.time.left, self.stream.sample_seconds
        if left < self.cost.seconds(LEAST_STEPS, LARGEST_STRIDE):  # no other field could follow
            return
        self.stream.light_by(self.best, GATHER_PART * left)
        self.time.lengthen_passes(self.stream.sample_seconds - before)

    def evaluate(self, field: GaussianPhotonField, fitted: HalfColours) -> None:
        """Estimate the PSNR of a field, and keep it unless its training failed."""
        passes = self.stream.count
        most = passes // LEAST_PER_ESTIMATE
        self._add_estimates(min(self.quality.needed_passes(field), most))
        psnr = self.quality.psnr(field)
        before = float("-inf")
        if self.best is not None:  # compared with the same passes as the new field
            before = self.quality.psnr(self.best)
            self.history[-1] = self.passes, before
        self.in_vain = self.in_vain + 1 if psnr - before < LEAST_GAIN else 0
        if psnr >= before - TOLERATED:
            self.add_error(field, fitted)
            if self.groups is not None:
                field.lights = FieldLights(self.groups, self.split_light(field))
            field.record = self._origin()
            self.best, self.passes, self.psnr = field, passes, psnr
            self.history.append((passes, psnr))
        else:
            self.psnr = before

    def judge(self) -> None:
        """Estimate the PSNR of the best field from enough passes."""
        assert self.best is not None
        if self.quality.passes < ENOUGH_PASSES:
            self._add_estimates(ENOUGH_PASSES)
            self.psnr = self.quality.psnr(self.best)
            self.history[-1] = self.passes, self.psnr

    def fit_halves(self, field: GaussianPhotonField) -> HalfColours:
        """What the last field would be if fitted to each half of the photons."""
        assert self.halves is not None
        recipe = Recipe(self.field_settings)
        first, second = (recipe.supervise(half) for half in self.halves)
        return HalfColours.fit(field, (first, second))

    def add_error(self, field: GaussianPhotonField, fitted: HalfColours) -> None:
        """Give the last field its expected errors."""
        error = estimate_error(field, fitted, self.stream.blur)
        field.set_error(error)
        field.set_error(error * np.float32(self.quality.error_scale(field)))

    def split_light(self, field: GaussianPhotonField) -> np.ndarray:
        """The irradiance of the last field's Gaussians from each group of emitters, (G, N, 3)."""
        assert self.halves is not None
        points = Recipe(self.field_settings).supervise(self.stream.mean(self.halves))
        return split_light(field, points, self.stream.by_group())

    def _add_estimates(self, wanted: int) -> None:
        """Add passes for the estimate: :data:`LEAST_PASSES` in any case, more unless the time was
        up long ago."""
        late = GRACE * (self.goals.seconds or 0)
        while self.quality.passes < wanted and (
            self.quality.passes < LEAST_PASSES or not self.time.is_over(-late)
        ):
            self.quality.add_pass()

    def result(self) -> GaussianPhotonField:
        """The field with its record."""
        assert self.best is not None and self.psnr is not None
        sppm = self.quality.sppm_psnr(self.best, self.passes)
        if self.psnr < POOR or self.psnr < sppm - FAR_BELOW:
            log.warning(FAILED, self.psnr, self.passes, sppm)
        self.best.record = {
            "passes": self.passes,
            "estimated_psnr": self.psnr,
            "fields": self.history,
            "exposure": self.quality.exposure,
            "seconds": self.time.spent,
            "seed": self.seed,
            "fingerprint": self.fingerprint,
        }
        self.save()
        return self.best

    def _report(self, trainer: Trainer, progress: Progress) -> None:
        self.error = progress.held_out_error
        # A copy: later steps change the trainer's field, and the unit of its colours.
        field = copy.copy(trainer.current_field())
        field.record = self._origin()
        self._tell(field)

    def _origin(self) -> dict[str, Any]:
        """The record of a field that is shown during the fit, because it may be kept."""
        return {"passes": self.stream.count, "fingerprint": self.fingerprint}

    def _count_pass(self, passes: int) -> None:
        """After a pass: measure its time, and add to the estimate of the PSNR."""
        self.time.note_pass()
        if self.quality.passes < passes / PASSES_PER_ESTIMATE:
            self.quality.add_pass()
        if time.perf_counter() - self.saved > SAVE_SECONDS:
            self.save()
        self.time.start_pass()
        # A draft is always followed by another field.
        is_draft = self.last is not None and self.last.is_draft
        self._end_in_time(float("-inf") if is_draft else 0)

    def _count_step(self, steps: int) -> None:
        self.steps = steps
        # Not before any training: all the photons of the last field would be wasted.
        trained = steps >= STEPS_PER_EVALUATION
        self._end_in_time(self.reserve if trained else float("-inf"))

    def _end_in_time(self, reserve: float = 0) -> None:
        """Report the progress; end the fit if its time, less a reserve, is up and there is a
        field."""
        self._tell(None)
        if self.best is not None and self.time.is_over(reserve):
            raise _OutOfTime

    def _plan(self) -> Plan | None:
        """Plan the next field."""
        pass_seconds = self.time.pass_seconds * (1 + 1 / PASSES_PER_ESTIMATE)
        done, most = self.stream.count, self.goals.passes
        gathers = self.stream.gathered is not None
        times = self.clock.seconds(), self.time.left, pass_seconds
        return plan_next(done, self.last, most, *times, self.cost, gathers)

    def _tell(self, field: GaussianPhotonField | None) -> None:
        self.callback(
            FitProgress(
                passes=self.stream.count,
                all_passes=self.all_passes,
                steps=self.steps,
                all_steps=self.all_steps,
                held_out_error=self.error,
                psnr=self.psnr,
                seconds=self.time.spent,
                field=field,
            )
        )

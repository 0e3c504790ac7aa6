"""``gpf.fit``: from a scene to a field, without any choice."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mitsuba as mi

from gpf.core.errors import UserError, is_interrupt
from gpf.field.field import GaussianPhotonField
from gpf.field.gaussians import Gaussians
from gpf.field.initialization import InitialFieldSettings
from gpf.fitting.quality import QualityEstimate
from gpf.guiding.emission_plan import EmissionPlan, VisibleRegionSettings
from gpf.importing.placement import place_cameras
from gpf.scene.bounds import scene_bounds
from gpf.scene.fingerprint import fingerprint
from gpf.scene.sensors import film_aspect, make_sensor, scene_cameras, views_of_sensors
from gpf.sppm.reference import ReferenceSettings
from gpf.training.gaussian_count import choose_count
from gpf.training.recipe import Recipe, open_stream
from gpf.training.settings import TrainingSettings
from gpf.training.streaming import PhotonStream, StreamSettings, train_on_stream
from gpf.training.trainer import Progress, Trainer

DEFAULT_PASSES = 300
"""Photon passes if neither a time, a PSNR nor a number of passes is asked for."""

# With a time or a PSNR as the goal: passes until the first complete field, optimiser steps of each
# field, and the factor by which the number of passes then grows.
FIRST_PASSES, STEPS, GROWTH = 64, 300, 2

# A PSNR is out of reach if GROWTH times as many passes gain less than this, dB, twice in turn.
LEAST_GAIN = 0.1

# One pass for the estimate of the PSNR comes with so many passes for the field.
PASSES_PER_ESTIMATE = 8

# Rows of the images of cameras that are placed because none are given.
ROWS = 256

FIELD = InitialFieldSettings()
REGION = VisibleRegionSettings(rays=131_072, pilot_paths=262_144)

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class FitProgress:
    """How far a fit is.

    Attributes
    ----------
    passes, all_passes: photon passes so far, and those that are planned.
    steps, all_steps: optimiser steps since the last complete field, and until the next.
    held_out_error: error at points that the training does not use, in units of the mean target;
        None before the first evaluation.
    psnr: estimated PSNR of the field's images against an SPPM reference with 1000 passes, dB; None
        before the first complete field.
    seconds: since the start.
    field: the field so far, after each evaluation; else None. Later steps change it.
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
) -> GaussianPhotonField:
    """Fit a field to a scene.

    The fit ends at the first goal that is reached; without any goal, after
    :data:`DEFAULT_PASSES` passes. Interrupted by Ctrl-C, it returns the best field so far.

    Parameters
    ----------
    sensors: cameras that look at what the field is for; by default cameras are placed around the
        scene's own, as ``gpf scene import`` does.
    seconds: time for the whole fit, wall clock.
    target_psnr: estimated PSNR of images against an SPPM reference with 1000 passes, dB.
    passes: photon passes.
    callback: called after each pass and each optimiser step.

    Raises
    ------
    UserError: a goal is not above 0; the cameras see no diffuse surface; no light reaches the
        surfaces that they see; or the scene has a material that is not supported.
    """
    for name, value in (("seconds", seconds), ("target_psnr", target_psnr), ("passes", passes)):
        if value is not None and value <= 0:
            raise UserError(name, f"is {value}", "Give a number above 0, or leave it out.")
    if seconds is None and target_psnr is None and passes is None:
        passes = DEFAULT_PASSES
    run = _Fit(scene, sensors, seed, callback, seconds)
    try:
        run.start(passes)
        while not run.is_done(target_psnr, passes):
            run.go_on(target_psnr, passes)
    except _OutOfTime:
        run.trainer.judge()
        run.evaluate()
    except BaseException as error:
        if run.best is None or not is_interrupt(error):
            raise
        log.warning("Interrupted: this is the field after %s passes.", run.stream.count)
    return run.result()


def default_sensors(scene: mi.Scene) -> list[mi.Sensor]:
    """Cameras that are placed around the scene's own.

    Raises
    ------
    UserError: the scene has no perspective camera.
    """
    own = views_of_sensors(scene)
    if not own:
        raise UserError(
            "scene", "has no perspective camera", "Add one to the scene, or give sensors."
        )
    aspect = film_aspect(scene_cameras(scene)[0])
    placed = place_cameras(scene, own, aspect)
    width = max(1, round(ROWS * aspect))
    return [make_sensor(view, width, ROWS) for view in (*placed.train, *placed.novel)]


class _OutOfTime(Exception):
    """The time for the fit is over."""


class _Fit:
    """A fit in progress: complete fields from more and more passes of the same stream."""

    def __init__(
        self,
        scene: mi.Scene,
        sensors: Sequence[mi.Sensor] | None,
        seed: int,
        callback: Callable[[FitProgress], None],
        seconds: float | None,
    ) -> None:
        self.begin = time.perf_counter()
        self.scene, self.seed, self.callback = scene, seed, callback
        self.deadline = float("inf") if seconds is None else self.begin + seconds
        self.sensors = list(default_sensors(scene) if sensors is None else sensors)
        self.stream: PhotonStream
        self.trainer: Trainer
        self.field: GaussianPhotonField
        self.best: Gaussians | None = None
        self.psnr: float | None = None
        self.in_vain = 0
        self.all_passes = 0
        self.error: float | None = None
        self.steps = 0
        self.pass_seconds, self.step_seconds = 0.0, 0.0
        self._last, self._counted = self.begin, 0

    def start(self, passes: int | None) -> None:
        """Look around, choose the points and the Gaussians, and fit the first complete field."""
        self.all_passes = passes or FIRST_PASSES
        training = TrainingSettings(steps=STEPS, seed=self.seed)
        self.recipe = Recipe(FIELD, training)
        region = REGION.model_copy(update={"seed": self.seed})
        plan = EmissionPlan.make(self.scene, self.sensors, region)
        settings = ReferenceSettings(seed=self.seed).measure(self.scene, self.sensors[0], plan)
        self.quality = QualityEstimate(self.scene, self.sensors, settings, self.seed, plan.source)
        self.settings = StreamSettings(passes=self.all_passes, seed=self.seed)
        named = {f"{k}": sensor for k, sensor in enumerate(self.sensors)}
        self.stream, photons = open_stream(
            self.scene, named, plan, settings, self.settings, self.recipe
        )
        targets = self.stream.targets()
        photons = self.recipe.select_photons(photons)
        bounds = scene_bounds(self.scene)
        count = choose_count(self.recipe, photons, targets, bounds, self.stream)
        field = self.recipe.initial_field(count, photons, targets, bounds)
        self.trainer = self.recipe.trainer(field, self.recipe.supervise(targets))
        self._train()

    def is_done(self, target_psnr: float | None, passes: int | None) -> bool:
        """Whether a goal is reached, or can no longer be reached."""
        if passes is not None and self.stream.count >= passes:
            return True
        if target_psnr is not None:
            if self.psnr is not None and self.psnr >= target_psnr:
                return True
            if self.in_vain >= 2:
                log.warning(
                    "More passes do not raise the estimated PSNR of %.1f dB to %.1f dB.",
                    self.psnr,
                    target_psnr,
                )
                return True
        if self.deadline < float("inf"):
            return self._passes_that_fit() < 1.25 * self.stream.count
        return False

    def go_on(self, target_psnr: float | None, passes: int | None) -> None:
        """Fit the next complete field, from more passes."""
        wanted = float("inf") if target_psnr is None else GROWTH * self.stream.count
        self.all_passes = int(min(wanted, self._passes_that_fit(), passes or float("inf")))
        first = min(GROWTH * self.stream.count, self.all_passes)
        self.settings = self.settings.model_copy(update={"passes": self.all_passes, "first": first})
        # Before the trainer is made, so that its targets are those of the first round.
        self._last, self._counted = time.perf_counter(), self.stream.count
        self.stream.advance(first, lambda passes: self._tick(passes, 0))
        points = self.recipe.supervise(self.stream.targets())
        anisotropic = self.recipe.field.anisotropic
        self.trainer = Trainer(self.field, points, self.recipe.train, anisotropic=anisotropic)
        self._train()

    def evaluate(self) -> None:
        """Estimate the PSNR of the field, and keep it if it is the best so far."""
        self.field = self.trainer.finish()
        while self.quality.passes < 2:
            self.quality.add_pass()
        before = float("-inf")
        if self.best is not None:  # compared with the same passes as the new field
            state = self.field.gaussians
            self.field.update(self.best)
            before = self.quality.psnr(self.field)
            self.field.update(state)
        self.psnr = self.quality.psnr(self.field)
        self.in_vain = self.in_vain + 1 if self.psnr - before < LEAST_GAIN else 0
        if self.psnr < before:
            self.psnr = before
        else:
            self.best = self.field.gaussians
        self._tell(self.field)

    def result(self) -> GaussianPhotonField:
        """The field with its record."""
        if self.best is not None:
            self.field.update(self.best)
        self.field.record = {
            "passes": self.stream.count,
            "estimated_psnr": self.psnr,
            "exposure": self.quality.exposure,
            "seconds": time.perf_counter() - self.begin,
            "seed": self.seed,
            "fingerprint": fingerprint(self.scene),
        }
        return self.field

    def _train(self) -> None:
        self._last, self._counted = time.perf_counter(), self.stream.count
        train_on_stream(
            self.trainer,
            self.stream,
            self.settings,
            self.recipe.supervise,
            self._report,
            self._tick,
        )
        self.evaluate()

    def _report(self, progress: Progress) -> None:
        self.error = progress.held_out_error
        self._tell(self.trainer.current_field())

    def _tick(self, passes: int, steps: int) -> None:
        """After a pass or a step: measure its time, and end the fit if its time is over."""
        self.steps, spent = steps, time.perf_counter() - self._last
        if passes > self._counted:
            self._counted = passes
            self.pass_seconds = 0.8 * (self.pass_seconds or spent) + 0.2 * spent
            if self.quality.passes < passes / PASSES_PER_ESTIMATE:
                self.quality.add_pass()
        else:
            self.step_seconds = 0.9 * self.step_seconds + 0.1 * spent
        self._tell(None)
        if time.perf_counter() > self.deadline and self.trainer.step_count > 0:
            raise _OutOfTime
        self._last = time.perf_counter()

    def _passes_that_fit(self) -> float:
        """The number of passes, with those so far, whose field is complete before the deadline."""
        rest = self.deadline - time.perf_counter() - STEPS * self.step_seconds
        each = self.pass_seconds * (1 + 1 / PASSES_PER_ESTIMATE)
        return self.stream.count + 0.9 * rest / max(each, 1e-6)

    def _tell(self, field: GaussianPhotonField | None) -> None:
        self.callback(
            FitProgress(
                passes=self.stream.count,
                all_passes=self.all_passes,
                steps=self.steps,
                all_steps=STEPS,
                held_out_error=self.error,
                psnr=self.psnr,
                seconds=time.perf_counter() - self.begin,
                field=field,
            )
        )

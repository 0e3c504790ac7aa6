"""Stage `train`: fit the field to the targets."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from dvclive import Live

from gpf.core.progress import progress_bar
from gpf.core.structs import Photons
from gpf.field.io import save_field
from gpf.scene.bounds import scene_bounds
from gpf.training.checkpoint import restore_trainer, save_trainer
from gpf.training.gaussian_count import choose_count
from gpf.training.recipe import open_stream
from gpf.training.streaming import PhotonStream, train_on_stream
from gpf.training.targets import Targets
from gpf.training.trainer import Progress, Trainer
from stages.common.code import digest_of
from stages.common.costs import CostMeter
from stages.common.workspace import Workspace
from stages.photons import load_photons


def train_field(scene_name: str) -> None:
    """Fit the scene's field."""
    fit(Workspace.open(scene_name))


def fit(work: Workspace) -> None:
    """Fit a field; save its best state, the training curves and the costs."""
    section, recipe = work.params.train, work.params.recipe
    costs, stream = CostMeter(), None
    if section.supervision == "streaming":
        with costs.measure("stream"):
            stream, photons = stream_of(work)
            targets = stream.targets()
    else:
        photons, targets = load_photons(work), Targets.load(work.targets)
    photons, points = recipe.select_photons(photons), recipe.supervise(targets)
    bounds = scene_bounds(work.load_scene())
    with costs.measure("initialization"):
        count = choose_count(recipe, photons, targets, bounds, stream)
        field = recipe.initial_field(count, photons, targets, bounds)
    with costs.measure("training"):
        trainer = recipe.trainer(field, points)
    fingerprint = {
        "code": digest_of("train"),
        "gaussians": count,
        "targets": work.digest(work.targets),
        "photons": work.digest(work.photons),
        "params": _params(work),
    }
    if stream is None:
        spent = restore_trainer(trainer, work.checkpoint("train"), fingerprint)
        if spent:
            costs.parts["training"] = spent
    curves = str(work.field_folder / "training")
    with Live(curves, save_dvc_exp=False, dvcyaml=None, report=None) as live:

        def report(progress: Progress) -> None:
            live.step = progress.step
            live.log_metric("training_error", progress.training_error)
            live.log_metric("held_out_error", progress.held_out_error)
            live.next_step()

        # A checkpoint contains the curve so far.
        for progress in trainer.history:
            report(progress)
        if stream is None:
            _train_on_references(work, trainer, fingerprint, costs, report)
        else:
            _train_on_stream(work, trainer, stream, costs, report)
    trained = trainer.finish()
    trained.record = {
        "scene": work.scene_digest,
        "steps": trainer.step_count,
        "held_out_error": trainer.best_error,
        "params": _params(work),
    }
    save_field(trained, work.field, work.params.field.precision)
    work.checkpoint("train").unlink(missing_ok=True)
    costs.facts |= {"held_out_error": trainer.best_error, "gaussians": count}
    costs.facts |= trained.settings.model_dump()
    costs.note_peak_memory()
    costs.write(work.cost("train"))


def stream_of(work: Workspace) -> tuple[PhotonStream, Photons]:
    """A stream that has done its first passes, and photons for the Gaussians."""
    scene = work.load_scene()
    plan = work.emission_plan(scene)
    sensors = {view.name: work.sensor(view) for view in work.views.train}
    passes = work.params.reference.measure(scene, next(iter(sensors.values())), plan)
    return open_stream(scene, sensors, plan, passes, work.params.stream, work.params.recipe)


def _params(work: Workspace) -> dict[str, Any]:
    """The sections of params.yaml that the training depends on."""
    names = ["train", "field"]
    if work.params.train.supervision == "streaming":
        names += ["stream", "reference"]
    return {name: getattr(work.params, name).model_dump() for name in names}


def _train_on_references(
    work: Workspace,
    trainer: Trainer,
    fingerprint: dict[str, Any],
    costs: CostMeter,
    report: Callable[[Progress], None],
) -> None:
    """Take all remaining steps, on constant targets; ``fingerprint``: of the checkpoints."""
    section, saved = work.params.train, time.monotonic()
    with progress_bar(f"{work.scene}: training", section.steps) as advance:

        def tick(step: int) -> None:
            nonlocal saved
            advance(step)
            if time.monotonic() - saved > section.checkpoint_seconds:
                cost = costs.so_far("training")
                save_trainer(trainer, work.checkpoint("train"), fingerprint, cost)
                saved = time.monotonic()

        with costs.measure("training"):
            trainer.run(report, tick)


def _train_on_stream(
    work: Workspace,
    trainer: Trainer,
    stream: PhotonStream,
    costs: CostMeter,
    report: Callable[[Progress], None],
) -> None:
    """Take all steps, alternating with passes."""
    total = work.params.stream.passes + work.params.train.steps
    with (
        progress_bar(f"{work.scene}: photons and training", total) as advance,
        costs.measure("training"),
    ):
        train_on_stream(
            trainer,
            stream,
            work.params.stream,
            work.params.recipe.supervise,
            report,
            lambda passes, steps: advance(passes + steps),
        )

"""Stage `train`: fit the field to the targets."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
from dvclive import Live
from scmrepo.exceptions import SCMError

from gpf.core.errors import UserError
from gpf.core.partial import replace_folder
from gpf.core.progress import progress_bar
from gpf.core.structs import Photons
from gpf.field.io import save_field
from gpf.field.settings import FieldSettings, sampled_lamps
from gpf.field.volume import VolumeField
from gpf.guiding.emission_plan import EmissionPlan
from gpf.scene import fingerprint as scenes
from gpf.scene.bounds import scene_bounds
from gpf.scene.media import Media
from gpf.sppm.passes import PassSettings, suit_scene
from gpf.training.settings import TrainingSettings
from gpf.training.streaming import PhotonStream
from gpf.training.targets import Targets
from gpf.training.trainer import Progress, Trainer
from gpf.training.volume_light import VolumeLight, fit_volume
from stages.common.code import digest_of
from stages.common.costs import CostMeter
from stages.common.workspace import Workspace
from stages.photons import load_photons
from stages.references.targets import without_direct
from stages.training.checkpoint import restore_trainer, save_trainer
from stages.training.gaussian_count import choose_count
from stages.training.recipe import Recipe, open_stream


def run(scene_name: str) -> None:
    """Fit the scene's field."""
    fit(Workspace.open(scene_name))


def _open_curves(folder: Path) -> Live:
    try:
        return Live(str(folder), save_dvc_exp=False, dvcyaml=None, report=None)
    except SCMError as error:  # DVCLive asks for the last commit, even if it saves no experiment
        raise UserError(
            "git", f"has no commit here ({error})", "Run `git add -A && git commit -m Start` first."
        ) from error


def fit(work: Workspace) -> None:
    """Fit a field; save its best state, the training curves and the costs."""
    costs = CostMeter()
    bounds = scene_bounds(work.load_scene())
    streams = work.params.train.supervision == "streaming"
    trainer = _on_stream(work, costs, bounds) if streams else _on_references(work, costs, bounds)
    count = dr.width(trainer.gaussians.means)
    fingerprint = {
        "code": digest_of("train"),
        "gaussians": count,
        "targets": work.digest(work.targets),
        "photons": work.digest(work.photons),
        "params": _params(work),
    }
    if not streams:
        spent = restore_trainer(trainer, work.checkpoint("train"), fingerprint)
        if spent:
            costs.parts["training"] = spent
    # Moved into place only when they are complete.
    curves = work.checkpoint("curves").with_suffix("")
    with _open_curves(curves) as live:

        def report(progress: Progress) -> None:
            live.step = progress.step
            live.log_metric("training_error", progress.training_error)
            live.log_metric("held_out_error", progress.held_out_error)
            live.next_step()

        # A checkpoint contains the curve so far.
        for progress in trainer.history:
            report(progress)
        _train(work, trainer, None if streams else fingerprint, costs, report)
    trained = trainer.finish()
    if Media(work.load_scene()).there:
        with costs.measure("media"):
            trained.volume = _train_volume(work)
    trained.record = {
        "scene": work.scene_digest,
        "fingerprint": scenes.fingerprint(work.load_scene()),
        "steps": trainer.step_count,
        "held_out_error": trainer.best_error,
        "params": _params(work),
    }
    save_field(trained, work.field, work.params.field.precision)
    replace_folder(curves, work.field_folder / "training")
    work.checkpoint("train").unlink(missing_ok=True)
    work.forget_checkpoints()
    costs.facts |= {"held_out_error": trainer.best_error, "gaussians": count}
    costs.facts |= trained.settings.model_dump()
    costs.note_peak_memory()
    costs.write(work.cost("train"))


def _train_volume(work: Workspace) -> VolumeField:
    """The field in the scene's media, from passes of its own: as many as a stream's."""
    scene, sections = work.load_scene(), work.params
    plan = work.emission_plan(scene)
    settings = suit_scene(passes_of(work, scene, plan), scene)
    sensors = {view.name: work.sensor(view) for view in work.views.train}
    paths, passes = settings.path_settings(plan.source), sections.stream.passes
    light = VolumeLight(scene, sensors, paths, settings.alpha, sections.stream.seed)
    with progress_bar(f"{work.scene}: photons in media", passes) as bar:
        for number in range(1, passes + 1):
            light.add_pass(number)
            bar(number)
    training = TrainingSettings(steps=sections.train.steps, seed=sections.train.seed)
    return fit_volume(light, passes, 1, lambda r: FieldSettings(search_radius=r), training)


def _on_references(work: Workspace, costs: CostMeter, bounds: Any) -> Trainer:
    """The trainer of a new field, with targets from the stage `reference`."""
    recipe, targets = _recipe(work), Targets.load(work.targets, work.scene)
    if recipe.field.direct != "field":
        scene = work.load_scene()
        passes = passes_of(work, scene, work.emission_plan(scene))
        recipe = recipe.suit(scene, passes)
        if isinstance(recipe.field.direct, tuple):
            targets = without_direct(
                targets, scene, sampled_lamps(scene, recipe.field.direct), work.params.train.seed
            )
    photons = recipe.select_photons(load_photons(work))
    points = recipe.supervise(targets)
    with costs.measure("initialization"):
        count = choose_count(recipe, photons, targets, bounds)
        field = recipe.initial_field(count, photons, targets, bounds)
    with costs.measure("training"):
        return recipe.trainer(field, points)


def _on_stream(work: Workspace, costs: CostMeter, bounds: Any) -> Trainer:
    """The trainer of a new field, with targets from passes traced here."""
    passes = work.params.stream.passes
    with costs.measure("stream"):
        recipe, stream, photons = open_stream_of(work)
        with progress_bar(f"{work.scene}: photons", passes) as bar:
            stream.advance(passes, bar)
    with costs.measure("initialization"):
        return recipe.fit_stream(stream, stream.halves(), photons, bounds)


def open_stream_of(work: Workspace) -> tuple[Recipe, PhotonStream, Photons]:
    """The recipe for the scene, a stream that has no passes yet, and photons for the Gaussians."""
    scene = work.load_scene()
    plan = work.emission_plan(scene)
    passes = passes_of(work, scene, plan)
    sensors = {view.name: work.sensor(view) for view in work.views.train}
    recipe = _recipe(work).suit(scene, passes)
    return recipe, *open_stream(scene, sensors, plan, passes, work.params.stream, recipe)


def _recipe(work: Workspace) -> Recipe:
    return Recipe(work.params.field, work.params.train)


def passes_of(work: Workspace, scene: mi.Scene, plan: EmissionPlan) -> PassSettings:
    """The settings of the reference passes, measured where the first training view looks."""
    first = [work.sensor(view) for view in work.views.train[:1]]
    return work.params.reference.measure(scene, first, plan)


def _params(work: Workspace) -> dict[str, Any]:
    """The sections of params.yaml that the training depends on."""
    names = ["train", "field"]
    if work.params.train.supervision == "streaming":
        names += ["stream", "reference"]
    return {name: getattr(work.params, name).model_dump() for name in names}


def _train(
    work: Workspace,
    trainer: Trainer,
    fingerprint: dict[str, Any] | None,
    costs: CostMeter,
    report: Callable[[Progress], None],
) -> None:
    """Take all remaining steps; ``fingerprint``: for the checkpoints, or None to save none."""
    section, saved = work.params.train, time.monotonic()
    due = work.params.progress.checkpoint_seconds
    steps = progress_bar(f"{work.scene}: training", section.steps)
    with steps as advance, costs.measure("training"):
        for progress in trainer.steps():
            if progress:
                report(progress)
            advance(trainer.step_count)
            # Only with fresh lists: a resumed run starts with such lists, so it gets the same bits.
            fresh = trainer.rebuilt_at == trainer.step_count
            if fingerprint and fresh and time.monotonic() - saved > due:
                cost = costs.so_far("training")
                save_trainer(trainer, work.checkpoint("train"), fingerprint, cost)
                saved = time.monotonic()

"""Stage `baseline`: novel views rendered by a system that the field is compared with."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from baselines.options import BaselineOptions
from baselines.protocol import CannotServe, Prepared, SharedField, Task, TrainingView
from baselines.registry import make_baseline
from gpf.core.errors import UserError
from gpf.core.files import read_json, write_json
from gpf.core.images import check_finite, read_exr, write_exr, write_png
from gpf.core.progress import Bar, progress_bar, say
from gpf.core.yaml import suggest
from metrics import stage_costs
from metrics.files import CostFile
from stages.common.code import digest_of
from stages.common.costs import CostMeter, times_of
from stages.common.resuming import open_task_folder
from stages.common.subprocesses import run_each
from stages.common.timing_baseline import time_path
from stages.common.workspace import Workspace


def run(scene_name: str, method: str | None = None, go_on: bool = False) -> None:
    """Run one row of `baselines`, or all rows in `methods`, each in a separate process.

    If a method cannot serve the scene, the reason is saved; with ``go_on``, that is not an
    error.
    """
    work = Workspace.open(scene_name)
    if method is None:
        run_each("baseline", scene_name, "method", work.params.methods.all)
        return
    rows = work.params.baselines
    if method not in rows:
        todo = suggest(method, list(rows), "The rows of baselines in params.yaml are")
        raise UserError(f"method {method!r}", "does not exist", todo)
    try:
        render_with(work, method, rows[method])
    except CannotServe as refusal:
        refuse(work, method, refusal)
        if not go_on:
            raise
        say(f"{scene_name}, {method}: {refusal}")


def render_with(work: Workspace, method: str, options: BaselineOptions) -> None:
    """Prepare a system and render all novel views, as EXR and PNG.

    Raises
    ------
    CannotServe: the system cannot render the scene.
    """
    refuse_other_scenes(work, method, options)
    views, title = work.novel_views(), f"{work.scene}: {method}"
    with progress_bar(f"{title}, preparing", 1) as bar:
        prepared, costs = prepare(work, method, options, bar)
    with progress_bar(f"{title}, rendering", len(views)) as bar:
        render_all(work, method, prepared, costs, bar)
    images = [work.render(method, view.name) for view in views]
    keep_only(work.renders(method), *images, *(image.with_suffix(".png") for image in images))
    costs.facts |= {"views": len(views), **prepared.facts}
    costs.facts["storage_megabytes"] = prepared.storage_bytes / 1e6
    costs.note_peak_memory()
    costs.facts["path_seconds"] = time_path(work.load_scene(), views[0], work.film_size)
    costs.write(work.cost(f"baselines/{method}"))
    # Learned states are kept for the stage `animate`.
    if not options.learns:
        forget_state(work, method)


def prepare(
    work: Workspace, method: str, options: BaselineOptions, bar: Bar
) -> tuple[Prepared, CostMeter]:
    """The prepared system, and its costs; both include earlier runs of the same task."""
    state = open_state(work, method, options)
    costs = CostMeter.load(state / "costs.json")
    report = Reporter(bar, costs, state / "costs.json")
    task = make_task(work, options, state, report)
    with costs.measure("prepare"):
        prepared = make_baseline(options).prepare(task)
    costs.write(state / "costs.json")
    return prepared, costs


def refuse_other_scenes(work: Workspace, method: str, options: BaselineOptions) -> None:
    """Raise :class:`CannotServe` if the method is not meant for the scene."""
    if options.scenes and work.scene not in options.scenes:
        raise CannotServe(
            f"params.yaml: baselines.{method}.scenes",
            "not requested",
            f"Add {work.scene} there, or omit `scenes` to run it in all scenes.",
        )


@dataclass
class Reporter:
    """Shows the progress of a preparation, and saves its costs for a run that continues it."""

    bar: Bar
    costs: CostMeter
    file: Path
    kept: float = field(default_factory=time.monotonic)

    def __call__(self, done: int, total: int) -> None:
        """Report that ``done`` of ``total`` steps of the preparation are done."""
        self.bar(done, total)
        if time.monotonic() - self.kept > 10:
            self.costs.so_far("prepare")
            self.costs.write(self.file)
            self.kept = time.monotonic()


def render_all(
    work: Workspace, method: str, prepared: Prepared, costs: CostMeter, bar: Bar
) -> None:
    """Render the novel views."""
    options = work.params.baselines[method].model_dump(mode="json")
    for k, view in enumerate(work.views.novel):
        with costs.measure("render"):
            image = prepared.render(view, work.params.render.seed + k)
        check_finite(image, f"{work.scene}, {method}, view {view.name}")
        width, height = work.film_size
        if image.shape != (height, width, 3):
            raise ValueError(f"{method}: image has shape {image.shape}, not {(height, width, 3)}")
        path = work.render(method, view.name)
        record = {"method": method, "options": options, "view": view.model_dump(mode="json")}
        write_exr(path, {"radiance": image.astype(np.float32)}, record)
        write_png(path.with_suffix(".png"), image, work.views.exposure)
        bar(k + 1)


def make_task(
    work: Workspace, options: BaselineOptions, state: Path, report: Callable[[int, int], None]
) -> Task:
    """Everything that the system is given."""
    shared = SharedField(
        targets=work.targets,
        **effort(work, options),
        file=work.field if options.renders_field else None,
    )
    return Task(
        name=work.scene,
        scene=work.load_scene(),
        file=work.scene_snapshot / "scene.xml",
        size=work.film_size,
        exposure=work.views.exposure,
        training=training_views(work, options.training_views),
        rr_depth=work.params.render.rr_depth,
        seed=work.params.render.seed,
        state=state,
        field=shared,
        seconds_per_view=seconds_per_view(work) if options.waits_for_field else None,
        report=report,
    )


def effort(work: Workspace, options: BaselineOptions) -> dict[str, Any]:
    """The field's training and rendering settings, for systems that spend the same effort."""
    settings: dict[str, Any] = {}  # other systems do not depend on them
    if options.learns_from_targets:
        settings["train"] = work.params.train
    if options.learns_from_targets or options.renders_field:
        settings["render"] = work.params.render
    return settings


def training_views(work: Workspace, count: int) -> tuple[TrainingView, ...]:
    """``count`` training views with their references; the field's training views come first.

    Raises
    ------
    CannotServe: there are fewer than ``count``.
    """
    found: list[TrainingView] = []
    for view in (*work.views.train, *work.views.more):
        path = work.reference(view.name)
        if len(found) < count and path.exists():
            layers, record = read_exr(path)
            current = record.get("view") == view.model_dump(mode="json")
            if current and "radiance" in layers:
                found.append(TrainingView(view, layers))
    if len(found) < count:
        raise CannotServe(
            str(work.folder / "reference"),
            f"{count} training views with images are needed, but only {len(found)} exist",
            f"Set reference.images in params.yaml to auto or to {count}, list more views under "
            f"`more` in scenes/{work.scene}/views.yaml, and run the stages scene and reference.",
        )
    return tuple(found)


def seconds_per_view(work: Workspace) -> float:
    """Seconds that a view from the field takes, without compilation."""
    costs = read_json(work.cost("render"), CostFile)
    with times_of(work.cost("render")):
        return stage_costs.seconds_per_view(costs)


def open_state(work: Workspace, method: str, options: BaselineOptions) -> Path:
    """The folder for a preparation's state; keeps what an earlier run of the same task saved."""
    task = {
        "code": digest_of(*options.lists[:1]),
        "scene": work.scene_digest,
        "options": options.model_dump(mode="json"),
        "exposure": work.views.exposure,
        "effort": {k: v.model_dump(mode="json") for k, v in effort(work, options).items()},
        "rr_depth": work.params.render.rr_depth,
        "seconds_per_view": seconds_per_view(work) if options.waits_for_field else None,
        "size": list(work.film_size),
        "seed": work.params.render.seed,
        "field": work.digest(work.field) if options.renders_field else None,
        "targets": work.digest(work.targets),
        "views": [
            work.digest(work.reference(view.name)) for view in (*work.views.train, *work.views.more)
        ],
    }
    return open_task_folder(state_folder(work, method), task)


def forget_state(work: Workspace, method: str) -> None:
    """Remove the state of a method's preparation."""
    shutil.rmtree(state_folder(work, method), ignore_errors=True)
    work.forget_checkpoints()


def state_folder(work: Workspace, method: str) -> Path:
    """The folder for the state of a method's preparation."""
    return work.folder / "checkpoints" / f"baseline-{method}"


def keep_only(folder: Path, *files: Path) -> None:
    """Remove all other files from a folder once the new ones are there."""
    for other in set(folder.iterdir()) - set(files):
        other.unlink()


def refuse(work: Workspace, method: str, refusal: CannotServe) -> None:
    """Save the reason in place of images."""
    file = work.refusal(method)
    write_json(file, {"reason": refusal.what, "where": refusal.where, "todo": refusal.todo})
    keep_only(file.parent, file)
    costs = CostMeter()
    costs.facts["reason"] = refusal.what
    costs.write(work.cost(f"baselines/{method}"))

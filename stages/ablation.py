"""Stage `ablation`: variants of the field, which go through the same steps as the field itself."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from gpf.core.errors import UserError, WriteError, without_folders
from gpf.core.files import read_json, write_json
from gpf.core.partial import replace_folder
from gpf.core.progress import say
from gpf.core.yaml import suggest
from gpf.field.io import read_field
from gpf.training.targets import Targets
from metrics.files import CostFile
from metrics.stage_costs import learning_seconds, seconds_per_view
from stages.common.code import digest_of
from stages.common.costs import CostMeter
from stages.common.resuming import open_task_folder
from stages.common.subprocesses import run_each
from stages.common.workspace import Workspace
from stages.config.params import Params
from stages.config.titles import variant_title
from stages.metrics import Judge, summarize
from stages.photons import load_photons
from stages.render import render_novel_views
from stages.train import fit

# Sections of params.yaml that a variant's field depends on.
SECTIONS = ("film", "visible_region", "reference", "field", "train", "stream", "render")


def run(scene_name: str, variant: str | None = None, go_on: bool = False) -> None:
    """Run one row of `ablations.variants`, or all rows in `run`, each in a separate process.

    If a variant cannot be made in the scene, the reason is saved; with ``go_on``, that is not an
    error. A variant with the same parameters as the field gets the field's numbers.
    """
    work = Workspace.open(scene_name)
    ablations = work.params.ablations
    if variant is None:
        run_each("ablation", scene_name, "variant", ablations.run)
        return
    rows = ablations.variants
    if variant not in rows:
        todo = suggest(variant, list(rows), "The rows of ablations.variants in params.yaml are")
        raise UserError(f"variant {variant!r}", "does not exist", todo)
    row = {
        "variant": variant,
        "title": variant_title(ablations.variants[variant]),
        "group": rows[variant].group,
        "overrides": rows[variant].set,
    }
    common = common_count(work)
    params = work.params.variant(variant, common)
    if params == work.params.vary(common):
        found = numbers(work, read_json(work.metrics("gpf"), dict[str, Any]))
        save(work, row, {"same_as": "gpf", **found}, {})
        say(f"{scene_name}: {variant} has the same parameters as the field")
        return
    # Files of earlier stages are read first: if one is missing, that is not the variant's fault.
    judge = Judge.open(work)
    Targets.load(work.targets, work.scene)
    load_photons(work)
    try:
        make(work, row, params, judge)
    except WriteError:
        raise
    except UserError as refusal:
        reason, todo = (
            without_folders(t) for t in (f"{refusal.where}: {refusal.what}", refusal.todo)
        )
        shutil.rmtree(_state(work, variant), ignore_errors=True)
        save(work, row, {"reason": reason, "todo": todo}, {})
        if not go_on:
            raise
        say(f"{scene_name}, {variant}: {refusal}")


def common_count(work: Workspace) -> dict[str, Any]:
    """With `field.gaussians: auto`, the field's number of Gaussians; all variants use it, so that
    they differ only in the settings that they name."""
    if work.params.field.gaussians != "auto":
        return {}
    return {"field.gaussians": len(read_field(work.field).tensors["means"])}


def make(work: Workspace, row: Mapping[str, Any], params: Params, judge: Judge) -> None:
    """Train, render and measure a variant; resumes an interrupted run."""
    name = row["variant"]
    task = {
        "code": digest_of("train", "render"),
        "scene": work.scene_digest,
        "targets": work.digest(work.targets),
        "photons": work.digest(work.photons),
        "views": work.digest(work.views_file),
        "params": {section: getattr(params, section).model_dump() for section in SECTIONS},
    }
    state = open_task_folder(_state(work, name), task)
    variant = work.variant(params, state)
    say(f"{work.scene}, {name}: {row['overrides']}")
    # Each stage writes its costs last, so its cost file shows that it is complete.
    if not variant.cost("train").exists():
        fit(variant)
    if not variant.cost("render").exists():
        render_novel_views(variant)
    costs = CostMeter()
    with costs.measure("metrics"):
        judge = replace(judge, work=variant)
        measured = summarize({v: judge.compare_render("gpf", v) for v in judge.references})
    parts = costs.parts
    for stage in ("train", "render"):
        parts = read_json(variant.cost(stage), CostFile)["parts"] | parts
    found = numbers(variant, measured)
    shutil.rmtree(state / "checkpoints", ignore_errors=True)
    (state / "task.json").unlink()
    save(work, row, found, parts, state)


def numbers(work: Workspace, measured: Mapping[str, Any]) -> dict[str, Any]:
    """Quality, times and sizes of a field, excluding the search for its number of Gaussians."""
    train, render = (read_json(work.cost(stage), CostFile) for stage in ("train", "render"))
    path_seconds = render["facts"].get("path_seconds")
    return {
        **measured,
        "seconds_per_view": seconds_per_view(render),
        **({} if path_seconds is None else {"path_seconds": path_seconds}),
        "storage_megabytes": render["facts"]["field_megabytes"],
        "train_seconds": learning_seconds(train),
        "gaussians": len(read_field(work.field).tensors["means"]),
    }


def save(
    work: Workspace,
    row: Mapping[str, Any],
    found: Mapping[str, Any],
    parts: Mapping[str, Mapping[str, float]],
    state: Path | None = None,
) -> None:
    """Write the numbers and costs of a variant, and move its ``state`` to the variant's folder.

    Without a state, the folder is left empty.
    """
    name = row["variant"]
    folder = work.folder / "ablations" / name
    if state is None:
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
    else:
        folder.parent.mkdir(parents=True, exist_ok=True)
        replace_folder(state, folder)
    work.forget_checkpoints()
    costs = CostMeter(parts)
    costs.facts |= {key: found[key] for key in ("same_as", "reason", "gaussians") if key in found}
    costs.write(work.cost(f"ablations/{name}"))
    write_json(folder.with_suffix(".json"), {**row, **found})


def _state(work: Workspace, variant: str) -> Path:
    return work.folder / "checkpoints" / f"ablation-{variant}"

"""Stage `ablation`: the field made otherwise, by the same steps, and measured like the field."""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from gpf.config.params import Params
from gpf.config.titles import variant_title
from gpf.core.errors import UserError
from gpf.core.files import read_json, write_json
from gpf.core.progress import say
from gpf.core.yaml import suggest
from gpf.field.io import read_field
from gpf.training.targets import Targets
from metrics.stage_costs import learning_seconds, seconds_per_view
from stages.common.code import digest_of
from stages.common.costs import CostMeter
from stages.common.resuming import open_task_folder
from stages.common.subprocesses import run_each
from stages.common.workspace import Workspace
from stages.metrics import Judge, summarize
from stages.photons import load_photons
from stages.render import render_novel_views
from stages.train import fit

# What a variant's field depends on.
SECTIONS = ("film", "visible_region", "reference", "field", "train", "stream", "render")


def run_ablations(scene_name: str, variant: str | None = None, go_on: bool = False) -> None:
    """Run a row of `ablations.variants`, or all that `run` lists, each in a process of its own.

    ``go_on``: a variant that cannot be made of the scene is no error; its reason is kept either
    way. A variant that is the field as it is refers to the field's numbers.
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
    alike = gaussians_of_all(work)
    params = work.params.variant(variant, alike)
    if params == work.params.vary(alike):
        found = numbers(work, read_json(work.metrics("gpf")))
        keep(work, row, {"same_as": "gpf", **found}, {})
        say(f"{scene_name}: {variant} is the field as it is")
        return
    # What is missing of the stages before is no fault of the variant.
    judge = Judge.open(work)
    Targets.load(work.targets)
    load_photons(work)
    try:
        make(work, row, params, judge)
    except UserError as refusal:
        reason = f"{refusal.where}: {refusal.what}"
        shutil.rmtree(_state(work, variant), ignore_errors=True)
        keep(work, row, {"reason": reason, "todo": refusal.todo}, {})
        if not go_on:
            raise
        say(f"{scene_name}, {variant}: {refusal}")


def gaussians_of_all(work: Workspace) -> dict[str, Any]:
    """With `field.gaussians: auto`, what the field has: variants are to differ in what they name
    alone."""
    if work.params.field.gaussians != "auto":
        return {}
    return {"field.gaussians": len(read_field(work.field).tensors["means"])}


def make(work: Workspace, row: Mapping[str, Any], params: Params, judge: Judge) -> None:
    """Train, render and measure; a run that was killed goes on where it was."""
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
    # Each writes its costs last.
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
        parts = read_json(variant.cost(stage))["parts"] | parts
    found = numbers(variant, measured)
    shutil.rmtree(state / "checkpoints", ignore_errors=True)
    (state / "task.json").unlink()
    keep(work, row, found, parts, state)


def numbers(work: Workspace, measured: Mapping[str, Any]) -> dict[str, Any]:
    """What is known of a field, the search for its number of Gaussians not counted."""
    train, render = (read_json(work.cost(stage)) for stage in ("train", "render"))
    path_seconds = render["facts"].get("path_seconds")
    return {
        **measured,
        "seconds_per_view": seconds_per_view(render),
        **({} if path_seconds is None else {"path_seconds": path_seconds}),
        "storage_megabytes": render["facts"]["field_megabytes"],
        "train_seconds": learning_seconds(train),
        "gaussians": len(read_field(work.field).tensors["means"]),
    }


def keep(
    work: Workspace,
    row: Mapping[str, Any],
    found: Mapping[str, Any],
    parts: Mapping[str, Mapping[str, float]],
    made: Path | None = None,
) -> None:
    """Write what was found, and put what was made in its place; without it, an empty folder."""
    name = row["variant"]
    folder = work.folder / "ablations" / name
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    if made is not None:
        os.replace(made, folder)
    work.forget_checkpoints()
    costs = CostMeter(parts)
    costs.facts |= {key: found[key] for key in ("same_as", "reason", "gaussians") if key in found}
    costs.write(work.cost(f"ablations/{name}"))
    write_json(folder.with_suffix(".json"), {**row, **found})


def _state(work: Workspace, variant: str) -> Path:
    return work.folder / "checkpoints" / f"ablation-{variant}"

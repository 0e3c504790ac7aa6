"""Stage `train`: photons and targets -> fitted field."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from dvclive import Live

from gpf.artifacts import read_tensors
from gpf.bounds import scene_bounds
from gpf.errors import UserError
from gpf.field import FieldSettings, GaussianPhotonField
from gpf.field_files import save_field
from gpf.gap_filling import find_gaps
from gpf.initialization import (
    InitializationSettings,
    initialize_gaussians,
    propose_search_radius,
)
from gpf.streaming import PhotonStream, train_on_stream
from gpf.structs import Photons, SurfacePoints, take
from gpf.supervision import Targets
from gpf.training import Progress, Trainer
from stages.costs import CostMeter
from stages.gaussian_count import choose_count
from stages.progress import console, progress_bar
from stages.streaming import open_stream, stream_settings
from stages.train_settings import training_settings
from stages.workspace import Workspace


def train_field(scene_name: str) -> None:
    """Fit the scene's field."""
    fit(Workspace.open(scene_name))


def fit(work: Workspace) -> None:
    """Fit a field, keep its best state, and record the curves."""
    section, fields = work.params.train, work.params.field
    costs, stream, judges = CostMeter(), None, None
    if section.supervision == "streaming":
        with costs.measure("stream"):
            stream, photons = open_stream(work)
            targets = stream.targets()
            if fields.gaussians == "auto":
                judges = supervise(work, stream.independent().targets())
    else:
        photons, targets = load_photons(work), Targets.load(work.targets)
    photons, points = photons_for_field(work, photons), supervise(work, targets)
    bounds = scene_bounds(work.load_scene())

    def make_field(count: int) -> GaussianPhotonField:
        return initial_field(work, count, photons, targets, bounds)

    with costs.measure("initialization"):
        count = choose_count(work, make_field, points, judges)
        field = make_field(count)
    with costs.measure("training"):
        trainer = Trainer(field, points, training_settings(work))
    if stream is None:
        spent = trainer.restore(work.checkpoint("train"), _fingerprint(work, count))
        if spent:
            costs.parts["training"] = spent
    curves = str(work.field_folder / "training")
    with Live(curves, save_dvc_exp=False, dvcyaml=None, report=None) as live:

        def report(progress: Progress) -> None:
            live.step = progress.step
            live.log_metric("training_error", progress.training_error)
            live.log_metric("held_out_error", progress.held_out_error)
            live.next_step()

        # The curve of an interrupted run is in its checkpoint.
        for progress in trainer.history:
            report(progress)
        if stream is None:
            _train_on_references(work, trainer, count, costs, report)
        else:
            _train_on_stream(work, trainer, stream, costs, report)
    trained = trainer.finish()
    trained.record = {
        "scene": work.scene_digest,
        "steps": trainer.step_count,
        "held_out_error": trainer.best_error,
        "params": _params(work),
    }
    save_field(trained, work.field, fields.precision)
    work.checkpoint("train").unlink(missing_ok=True)
    costs.facts |= {"held_out_error": trainer.best_error, "gaussians": count}
    costs.facts |= asdict(trained.settings)
    costs.note_peak_memory()
    costs.write(work.cost("train"))


def supervise(work: Workspace, targets: Targets) -> SurfacePoints:
    """The points that params.yaml has the field learn from, out of all targets."""
    section, fields = work.params.train, work.params.field
    return targets.supervised_points(section.points, fields.stores, section.loss, fields.direct)


def _params(work: Workspace) -> dict[str, Any]:
    names = ["train", "field"]
    if work.params.train.supervision == "streaming":
        names += ["stream", "reference"]
    return {name: getattr(work.params, name).model_dump() for name in names}


def _fingerprint(work: Workspace, count: int) -> dict[str, Any]:
    """What a checkpoint belongs to."""
    return {
        "gaussians": count,
        "targets": work.digest(work.targets),
        "photons": work.digest(work.photons),
        "params": _params(work),
    }


def _train_on_references(
    work: Workspace,
    trainer: Trainer,
    count: int,
    costs: CostMeter,
    report: Callable[[Progress], None],
) -> None:
    """All steps that are left, on targets that do not change."""
    section = work.params.train
    checkpoint, fingerprint = work.checkpoint("train"), _fingerprint(work, count)
    saved = time.monotonic()
    with progress_bar(f"{work.scene}: training", section.steps) as advance:

        def tick(step: int) -> None:
            nonlocal saved
            advance(step)
            if time.monotonic() - saved > section.checkpoint_seconds:
                trainer.save(checkpoint, fingerprint, costs.so_far("training"))
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
    """All steps, while passes come in."""
    total = work.params.stream.passes + work.params.train.steps
    with (
        progress_bar(f"{work.scene}: photons and training", total) as advance,
        costs.measure("training"),
    ):
        train_on_stream(
            trainer,
            stream,
            stream_settings(work),
            lambda targets: supervise(work, targets),
            report,
            lambda passes, steps: advance(passes + steps),
        )


def load_photons(work: Workspace) -> Photons:
    """The photons that the stage `photons` kept."""
    tensors, _ = read_tensors(work.photons, "photons", "photons")

    def columns(name: str) -> np.ndarray:
        return np.ascontiguousarray(tensors[name].T)

    return Photons(
        p=mi.Point3f(columns("position")),
        n=mi.Normal3f(columns("normal")),
        power=mi.Color3f(columns("power")),
        depth=mi.UInt32(tensors["depth"]),
    )


def photons_for_field(work: Workspace, photons: Photons) -> Photons:
    """Those of the light that the field is to have."""
    section = work.params.field
    if section.direct == "field":
        return photons
    indirect = dr.compress(photons.depth > 0)
    count = dr.width(indirect)
    if count == 0:
        raise UserError(
            f"scene {work.scene!r}",
            "its photons are direct light alone, which field.direct: emitters leaves to emitters",
            "Set field.direct to field.",
        )
    if section.gaussians != "auto" and count < section.gaussians:
        console.print(
            f"{work.scene}: {count} of the photons are not direct light; the field has as many "
            f"Gaussians, not {section.gaussians}. More photons.paths bring more",
            highlight=False,
        )
    return take(photons, indirect)


def initial_field(
    work: Workspace, count: int, photons: Photons, targets: Targets, bounds: tuple[Any, Any]
) -> GaussianPhotonField:
    """The field before training, with so many Gaussians."""
    section = work.params.field
    radius = section.search_radius
    if radius == "auto":
        radius = propose_search_radius(photons, count, targets.position, bounds)
    scale = 0.6 * radius if section.initial_scale == "auto" else section.initial_scale
    initial = InitializationSettings(
        gaussians=count,
        source=section.initialization,
        # That of the targets is not known here: the trainer sees to it.
        colour="density" if section.initial_colour == "density" else "flux",
        scale=scale,
        density_radius=radius,
    )
    settings = FieldSettings(
        search_radius=radius,
        k=section.k,
        neighbours=section.neighbours,
        blend=section.blend,
        stores=section.stores,
        direct=section.direct,
        normal_test=section.normal_test,
    )
    seed = work.params.train.seed
    gaussians = initialize_gaussians(photons, initial, bounds, seed)
    if section.fill_gaps and section.initialization == "photons":
        field = GaussianPhotonField(gaussians, settings, bounds)
        gaps = find_gaps(field, targets.position, targets.normal, seed)
        gaussians = initialize_gaussians(photons, initial, bounds, seed, gaps)
    if section.stores == "radiance":
        # Photons know nothing of what reflects their light; views do, on average.
        mean = targets.select("views").reflectance.mean(axis=0) / np.pi
        gaussians.irradiance *= mi.Color3f(*(float(c) for c in mean))
    return GaussianPhotonField(gaussians, settings, bounds)

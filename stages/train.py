"""Stage `train`: photons and targets -> fitted field."""

from __future__ import annotations

import time
from dataclasses import asdict
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from dvclive import Live

from gpf.artifacts import read_tensors
from gpf.bounds import scene_bounds
from gpf.field import FieldSettings, GaussianPhotonField
from gpf.field_files import save_field
from gpf.initialization import (
    InitializationSettings,
    initialize_gaussians,
    propose_search_radius,
)
from gpf.structs import Photons, take
from gpf.supervision import Targets
from gpf.training import LearningRates, Progress, Trainer, TrainingSettings
from stages.costs import CostMeter
from stages.progress import progress_bar
from stages.workspace import Workspace


def train_field(scene_name: str) -> None:
    """Fit a field, keep its best state, and record the curves."""
    work = Workspace.open(scene_name)
    section, fields = work.params.train, work.params.field
    costs = CostMeter()
    targets = Targets.load(work.targets)
    photons = load_photons(work)
    if fields.direct == "emitters":
        photons = take(photons, dr.compress(photons.depth > 0))
    bounds = scene_bounds(work.load_scene())

    points = targets.supervised_points(section.points, fields.stores, section.loss, fields.direct)
    with costs.measure("initialization"):
        field = initial_field(work, photons, targets, bounds)
    with costs.measure("training"):
        trainer = Trainer(field, points, training_settings(work))
    fingerprint = {
        "targets": work.digest(work.targets),
        "photons": work.digest(work.photons),
        "params": {"train": section.model_dump(), "field": work.params.field.model_dump()},
    }
    checkpoint = work.checkpoint("train")
    spent = trainer.restore(checkpoint, fingerprint)
    if spent:
        costs.parts["training"] = spent

    saved = time.monotonic()
    with Live(str(work.folder / "training"), save_dvc_exp=False, dvcyaml=None, report=None) as live:

        def report(progress: Progress) -> None:
            live.step = progress.step
            live.log_metric("training_error", progress.training_error)
            live.log_metric("held_out_error", progress.held_out_error)
            live.next_step()

        # The curve of an interrupted run is in its checkpoint.
        for progress in trainer.history:
            report(progress)
        with progress_bar(f"{scene_name}: training", section.steps) as advance:

            def tick(step: int) -> None:
                nonlocal saved
                advance(step)
                if time.monotonic() - saved > section.checkpoint_seconds:
                    trainer.save(checkpoint, fingerprint, costs.so_far("training"))
                    saved = time.monotonic()

            with costs.measure("training"):
                trained = trainer.run(report, tick)
    trained.record = {
        "scene": work.scene_digest,
        "steps": trainer.step_count,
        "held_out_error": trainer.best_error,
        "params": fingerprint["params"],
    }
    save_field(trained, work.field, work.params.field.precision)
    checkpoint.unlink(missing_ok=True)
    costs.facts |= {"held_out_error": trainer.best_error, **asdict(trained.settings)}
    costs.write(work.cost("train"))


def training_settings(work: Workspace) -> TrainingSettings:
    """The library's settings from the sections of params.yaml."""
    section = work.params.train
    return TrainingSettings(
        steps=section.steps,
        batch=section.batch,
        rates=LearningRates(**section.rates.model_dump()),
        final_rate=section.final_rate,
        rebuild_every=section.rebuild_every,
        evaluate_every=section.evaluate_every,
        held_out=section.held_out,
        from_targets=work.params.field.initial_colour == "targets",
        anisotropic=work.params.field.anisotropic,
        seed=section.seed,
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


def initial_field(
    work: Workspace, photons: Photons, targets: Targets, bounds: tuple[Any, Any]
) -> GaussianPhotonField:
    """The field before training."""
    section = work.params.field
    radius = section.search_radius
    if radius == "auto":
        radius = propose_search_radius(photons, section.gaussians, targets.position, bounds)
    scale = 0.6 * radius if section.initial_scale == "auto" else section.initial_scale
    initial = InitializationSettings(
        gaussians=section.gaussians,
        source=section.initialization,
        colour="flux" if section.initial_colour == "flux" else "density",
        scale=scale,
        density_radius=radius,
    )
    gaussians = initialize_gaussians(photons, initial, bounds, seed=work.params.train.seed)
    if section.stores == "radiance":
        # Photons know nothing of what reflects their light; views do, on average.
        mean = targets.select("views").reflectance.mean(axis=0) / np.pi
        gaussians.irradiance *= mi.Color3f(*(float(c) for c in mean))
    settings = FieldSettings(
        search_radius=radius,
        k=section.k,
        neighbours=section.neighbours,
        blend=section.blend,
        stores=section.stores,
        direct=section.direct,
        normal_test=section.normal_test,
    )
    return GaussianPhotonField(gaussians, settings, bounds)

"""Training: steps per second, and seconds to within 0.3 dB of the final PSNR."""

from __future__ import annotations

import time
from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
from stages.training.inputs import initial_field, load_photons, photons_for_field, supervise
from stages.training.settings import training_settings

from gpf.config.params import read_params
from gpf.core.errors import UserError
from gpf.core.images import read_exr
from gpf.field.io import read_field
from gpf.scene.bounds import scene_bounds
from gpf.training.targets import Targets
from gpf.training.trainer import Trainer
from metrics.image import psnr
from stages.common.workspace import Workspace

CHECK_EVERY = 50


def training_rows() -> list[tuple[str, str, str, str, str]]:
    """One row per scene of params.yaml that has targets and references."""
    rows = []
    for scene in read_params().scenes:
        try:
            seconds, final, rate = time_training(scene)
        except UserError as error:
            rows.append((f"training, {scene}", "not measured", str(error.todo), "", "8 s"))
            continue
        rows.append(
            (
                f"training to within 0.3 dB of its final {final:.1f} dB, {scene}",
                f"{seconds:.1f} s",
                f"{rate / 1e6:.1f} M points/s",
                "",
                "8 s",
            )
        )
    return rows


def time_training(scene_name: str) -> tuple[float, float, float]:
    """Seconds to 0.3 dB below the final PSNR, that PSNR, and supervised points per second."""
    work = Workspace.open(scene_name)
    scene = work.load_scene()
    targets = Targets.load(work.targets)
    section, views = work.params.train, work.views.novel
    references = {v.name: read_exr(work.reference(v.name))[0] for v in views}
    photons = photons_for_field(work, load_photons(work))
    count = len(read_field(work.field).tensors["means"])
    integrator = mi.load_dict({"type": "gpf"})
    settings = training_settings(work)
    curve: list[tuple[float, float]] = []

    # Twice: the first run compiles (once per kernel, not per step).
    for _ in range(2):
        curve.clear()
        start = time.perf_counter()
        field = initial_field(work, count, photons, targets, scene_bounds(scene))
        trainer = Trainer(field, supervise(work, targets), replace(settings, steps=section.steps))
        checking = 0.0
        while trainer.step_count < section.steps:
            trainer.advance(CHECK_EVERY)
            dr.sync_thread()
            spent = time.perf_counter() - start - checking
            paused = time.perf_counter()
            integrator.field = trainer.current_field()
            quality = [
                psnr(
                    np.array(
                        mi.render(
                            scene,
                            integrator=integrator,
                            sensor=work.sensor(
                                view, work.params.render.spp, work.params.render.sampler
                            ),
                            spp=work.params.render.spp,
                            seed=work.params.render.seed + k,
                        )
                    ),
                    references[view.name]["radiance"],
                    work.views.exposure,
                )
                for k, view in enumerate(views)
            ]
            curve.append((spent, float(np.mean(quality))))
            checking += time.perf_counter() - paused
    final = curve[-1][1]
    seconds = next(s for s, quality in curve if quality >= final - 0.3)
    rate = section.steps * min(section.batch, dr.width(trainer.training.p)) / curve[-1][0]
    return seconds, final, rate

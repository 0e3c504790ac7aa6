"""Training: points per second, and seconds to within 0.3 dB of the final PSNR."""

from __future__ import annotations

import time

import drjit as dr

from benchmarks.novel_views import mean_psnr
from gpf.config.params import read_params
from gpf.core.errors import UserError
from gpf.field.io import read_field
from gpf.scene.bounds import scene_bounds
from gpf.training.targets import Targets
from stages.common.workspace import Workspace
from stages.metrics import Judge
from stages.photons import load_photons
from stages.render import open_renderer

CHECK_EVERY = 50


def training_rows() -> list[tuple[str, str, str, str, str]]:
    """One row for each scene of params.yaml; without results, the row names the missing file."""
    rows = []
    for scene in read_params().scenes:
        try:
            seconds, final, rate = time_training(scene)
        except UserError as error:
            rows.append((f"training, {scene}", "not measured", str(error), "", "8 s"))
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
    """Seconds to 0.3 dB below the final PSNR, that PSNR in dB, and supervised points per second."""
    work = Workspace.open(scene_name)
    recipe, bounds = work.params.recipe, scene_bounds(work.load_scene())
    targets, photons = Targets.load(work.targets), recipe.select_photons(load_photons(work))
    count = len(read_field(work.field).tensors["means"])
    references = Judge.open(work).references
    renderer = open_renderer(work, work.params.render.spp)
    curve: list[tuple[float, float]] = []
    for _ in range(2):  # the first run compiles the kernels
        curve.clear()
        start, paused = time.perf_counter(), 0.0
        field = recipe.initial_field(count, photons, targets, bounds)
        trainer = recipe.trainer(field, recipe.supervise(targets))
        while trainer.step_count < recipe.train.steps:
            trainer.advance(min(CHECK_EVERY, recipe.train.steps - trainer.step_count))
            dr.sync_thread()
            now = time.perf_counter()
            renderer.integrator.field = trainer.current_field()
            curve.append((now - start - paused, mean_psnr(work, renderer, references)))
            paused += time.perf_counter() - now
    total, final = curve[-1]
    seconds = next(s for s, quality in curve if quality >= final - 0.3)
    batch = min(recipe.train.batch, dr.width(trainer.training.p))
    return seconds, final, recipe.train.steps * batch / total

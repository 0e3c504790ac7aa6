"""`python -m benchmarks.streaming SCENE …`: how soon a field that learns from a stream is good.

Needs the results of `dvc repro`, with a field that was trained on references; the quality of that
field is the standard of comparison. The unit of time is a view by SPPM with as many passes as the
references have. Its passes are timed before and after the training, so that other load affects
both.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass

import drjit as dr
from rich.console import Console
from rich.table import Table

from benchmarks.novel_views import mean_psnr
from benchmarks.single_passes import SinglePasses
from gpf.core.errors import UserError
from gpf.core.files import read_json
from gpf.field.io import read_field
from gpf.scene.bounds import scene_bounds
from gpf.training.gaussian_count import choose_count
from gpf.training.streaming import train_on_stream
from gpf.training.trainer import Progress
from stages.common.workspace import Workspace
from stages.metrics import Judge
from stages.render import open_renderer
from stages.train import stream_of

# Timed passes of SPPM for each novel view, before the training and after it.
PASSES = 16


@dataclass(frozen=True)
class Moment:
    """The mean PSNR of the novel views, dB, after a number of passes and seconds."""

    passes: int
    seconds: float
    quality: float


def main() -> None:
    """Print one table per scene, from the second of two runs; the first compiles the kernels."""
    console = Console(width=120)
    for name in sys.argv[1:]:
        work = Workspace.open(name)
        if read_field(work.field).record["params"]["train"]["supervision"] != "reference":
            raise UserError(str(work.field), "learned from a stream", "Train on the references.")
        train(work)
        single = SinglePasses(work)
        before = single.seconds(1, 0, PASSES)
        moments = train(work)
        passes = work.params.reference.passes
        view = passes * (before + single.seconds(1, 0, PASSES)) / 2
        final = read_json(work.metrics("gpf"))["mean"]["psnr"]
        table = Table("passes", "seconds", "of a view by SPPM", "PSNR", "minus references'")
        table.title = (
            f"{name}: {final:.2f} dB from the references; a view by SPPM, {passes} passes: "
            f"{view:.0f} s"
        )
        for moment in moments:
            table.add_row(
                str(moment.passes),
                f"{moment.seconds:.1f}",
                f"{moment.seconds / view:.2f}",
                f"{moment.quality:.2f}",
                f"{moment.quality - final:+.2f}",
            )
        console.print(table)


def train(work: Workspace) -> list[Moment]:
    """Train on a stream, and measure the novel views after each round of steps.

    The time for these measurements does not count.
    """
    start, paused = time.perf_counter(), 0.0
    recipe = work.params.recipe
    stream, photons = stream_of(work)
    targets, photons = stream.targets(), recipe.select_photons(photons)
    bounds = scene_bounds(stream.scene)
    count = choose_count(recipe, photons, targets, bounds, stream)
    field = recipe.initial_field(count, photons, targets, bounds)
    trainer = recipe.trainer(field, recipe.supervise(targets))
    renderer = open_renderer(work, work.params.render.spp)
    references, moments = Judge.open(work).references, []

    def report(progress: Progress) -> None:
        nonlocal paused
        dr.sync_thread()
        now = time.perf_counter()
        renderer.integrator.field = trainer.current_field()
        quality = mean_psnr(work, renderer, references)
        moments.append(Moment(stream.count, now - start - paused, quality))
        paused += time.perf_counter() - now

    train_on_stream(trainer, stream, work.params.stream, recipe.supervise, report)
    return moments


if __name__ == "__main__":
    main()

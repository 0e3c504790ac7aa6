"""`python -m benchmarks.streaming SCENE …`: how soon a field that learns from a stream gets good.

Needs the results of `dvc repro`, with a field that was trained on references; that field's quality
is the standard of comparison. The unit of time is a view by SPPM with as many passes as the
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
from gpf.fitting.fit import FitProgress, fit
from stages.common.workspace import Workspace
from stages.metrics import Judge
from stages.render import open_renderer

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
        table = Table("passes", "seconds", "SPPM views", "PSNR", "vs references")
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
    """Fit a field, and measure the novel views with each complete field along the way.

    The time for these measurements does not count.
    """
    start, paused = time.perf_counter(), 0.0
    scene, sensors = work.load_scene(), [work.sensor(view) for view in work.views.train]
    renderer = open_renderer(work, work.params.render.spp)
    references, moments = Judge.open(work).references, []

    def report(progress: FitProgress) -> None:
        nonlocal paused
        if progress.field is None or progress.steps < progress.all_steps:
            return
        dr.sync_thread()
        now = time.perf_counter()
        if moments and moments[-1].passes == progress.passes:
            return
        renderer.integrator.field = progress.field
        quality = mean_psnr(work, renderer, references)
        moments.append(Moment(progress.passes, now - start - paused, quality))
        paused += time.perf_counter() - now

    fit(scene, sensors, passes=work.params.stream.passes, callback=report)
    return moments


if __name__ == "__main__":
    main()

"""`python -m benchmarks.streaming SCENE …`: how soon a field that learns from a stream is good.

After `dvc repro`: the field that the references taught is what it is measured against, and a view
by SPPM, with as many passes as the references have, is the unit of time. Its passes are timed
before and after the training, in this process, so that other load on the machine meets both.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass

import gpf  # noqa: F401  (first: it tells Dr.Jit where libLLVM is)
from gpf.core.runtime import choose_variant

choose_variant("auto")

import drjit as dr  # noqa: E402
import numpy as np  # noqa: E402
from rich.console import Console  # noqa: E402
from rich.table import Table  # noqa: E402
from stages.training.inputs import initial_field, photons_for_field, supervise  # noqa: E402
from stages.training.settings import training_settings  # noqa: E402
from stages.training.streaming import open_stream, stream_settings  # noqa: E402

from benchmarks.single_passes import SinglePasses  # noqa: E402
from gpf.core.errors import UserError  # noqa: E402
from gpf.core.files import read_json  # noqa: E402
from gpf.core.images import read_exr  # noqa: E402
from gpf.field.io import read_field  # noqa: E402
from gpf.scene.bounds import scene_bounds  # noqa: E402
from gpf.training.gaussian_count import choose_count  # noqa: E402
from gpf.training.streaming import train_on_stream  # noqa: E402
from gpf.training.trainer import Progress, Trainer  # noqa: E402
from metrics.image import psnr  # noqa: E402
from stages.common.workspace import Workspace  # noqa: E402
from stages.render import FieldRenderer  # noqa: E402

# Of SPPM for each novel view, timed before the training and after it.
PASSES = 16


@dataclass(frozen=True)
class Moment:
    """After so many passes and seconds of preparation, novel views have this mean PSNR."""

    passes: int
    seconds: float
    quality: float


def main() -> None:
    """Print one table per scene; the first of two runs compiles, and is not shown."""
    console = Console(width=120)
    for name in sys.argv[1:]:
        work = Workspace.open(name)
        taught = read_field(work.field).record["params"]["train"].get("supervision", "reference")
        if taught != "reference":
            raise UserError(str(work.field), "learned from a stream", "Train on the references.")
        prepare(work)
        single = SinglePasses(work)
        before = single.seconds(1, 0, PASSES)
        moments = prepare(work)
        passes = work.params.reference.passes
        view = passes * (before + single.seconds(1, 0, PASSES)) / 2
        final = read_json(work.metrics("gpf"))["mean"]["psnr"]
        title = (
            f"{name}: {final:.2f} dB from the references; a view by SPPM, {passes}: {view:.0f} s"
        )
        table = Table("passes", "seconds", "of a view by SPPM", "PSNR", "to the references'")
        table.title = title
        for moment in moments:
            table.add_row(
                str(moment.passes),
                f"{moment.seconds:.1f}",
                f"{moment.seconds / view:.2f}",
                f"{moment.quality:.2f}",
                f"{moment.quality - final:+.2f}",
            )
        console.print(table)


def prepare(work: Workspace) -> list[Moment]:
    """Train on a stream, and look at novel views whenever a round of steps is done.

    The clock stands while they are rendered.
    """
    start, checking = time.perf_counter(), 0.0
    stream, photons = open_stream(work)
    targets, photons = stream.targets(), photons_for_field(work, photons)
    bounds = scene_bounds(stream.scene)
    count = choose_count(work, photons, targets, bounds, stream)
    field, points = initial_field(work, count, photons, targets, bounds), supervise(work, targets)
    trainer = Trainer(field, points, training_settings(work))
    renderer = FieldRenderer.open(work, work.params.film.height, work.params.render.spp)
    exposure, moments = work.views.exposure, []

    def report(progress: Progress) -> None:
        nonlocal checking
        dr.sync_thread()
        paused = time.perf_counter()
        renderer.integrator.field = trainer.current_field()
        quality = [
            psnr(
                renderer.render(view, work.params.render.seed + k).radiance,
                read_exr(work.reference(view.name))[0]["radiance"],
                exposure,
            )
            for k, view in enumerate(work.views.novel)
        ]
        seconds = paused - start - checking
        moments.append(Moment(stream.count, seconds, float(np.mean(quality))))
        checking += time.perf_counter() - paused

    train_on_stream(
        trainer, stream, stream_settings(work), lambda found: supervise(work, found), report
    )
    return moments


if __name__ == "__main__":
    main()

"""The quality of `gpf.fit` for a given time or number of passes, and of its first pictures."""

from __future__ import annotations

import time
from functools import partial
from typing import Annotated, Literal

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from benchmarks import check_scenes, cli
from benchmarks.judged import STANDARD, Judged, judge_views, kept_field, mean_psnr
from benchmarks.measured_scenes import MeasuredScene, open_scene
from benchmarks.regions import REGIONS
from benchmarks.truth import decibels, sppm
from gpf.field.field import GaussianPhotonField
from gpf.rendering.settings import RenderSettings
from gpf.rendering.timed_sampling import time_of
from gpf.scene.folders import list_scenes

COLUMNS = (
    *("passes", "s", "SPPM s", "Gaussians", "estimated", "measured", "second SPPM", "truth"),
)

# Of the pictures of `frame`: samples per pixel, and whether it is denoised.
SAMPLES = ((1, True), (2, True), (4, True), (8, True), (16, True), (16, False), (64, False))
FRAME_PASSES = 300


def fit(
    scenes: cli.Scenes = None,
    seconds: cli.EachSeconds = None,
    passes: cli.EachPasses = None,
    times: Annotated[
        float | None, typer.Option(help="Time of a fit, in views by SPPM with 1000 passes.")
    ] = None,
    views: Annotated[
        Literal["placed", "training", "judged"],
        typer.Option(
            help="Cameras: placed by the fit; the scene's training views, with its exposure; or "
            "those and the judged views, as the command `gpf fit` takes them from a file."
        ),
    ] = "placed",
    rows: cli.Rows = 256,
    reference_passes: cli.ReferencePasses = 200,
    kept: cli.Kept = cli.KEPT,
) -> None:
    """`gpf.fit` alone, once for each given time or number of passes.

    The judged views are the novel views of `scenes/`, or frames of the path that `gpf scene import`
    would place. A line has the time that SPPM with 1000 passes takes for a view, and the views'
    mean PSNR: as estimated by the fit; of the field, and of a second SPPM, against SPPM with 1000
    passes; and of the field / of SPPM against a truth with narrow kernels, in all and by region.
    """
    table = Table("scene", *COLUMNS, *REGIONS)
    for name in scenes or [*list_scenes(), *check_scenes.SCENES]:
        measured = open_scene(name)
        judged = judge_views(measured, rows, reference_passes, kept)
        view = time_view(measured, rows)
        asked = [{"seconds": times * view}] if times else cli.goals(seconds, passes) or [{}]
        cameras, exposure = None, None
        if views != "placed":
            cameras, exposure = measured.training_views, measured.exposure
            cameras = cameras if views == "training" else [*cameras, *judged.views]
        for goal in asked:
            field = measured.fit(cameras, rows, exposure=exposure, **goal)
            images = measured.render(field, judged.views, rows)
            table.add_row(name, *describe(field, images, judged, view))
            Console(width=190).print(table)


def describe(
    field: GaussianPhotonField, images: np.ndarray, judged: Judged, view: float
) -> list[str]:
    """The cells of a line; ``view``: seconds that SPPM takes for a view."""
    record, references_too = field.record, judged.reference_errors()
    errors = judged.truth.errors(images)
    cells = [
        str(record["passes"]),
        f"{record['seconds']:.0f}",
        f"{view:.0f}",
        str(len(field.gaussians.means.numpy().T)),
        f"{record['estimated_psnr']:.1f}",
        mean_psnr(judged.differences(images)),
        mean_psnr(2 * judged.noise(STANDARD)),
        f"{mean_psnr(errors)} / {mean_psnr(references_too)}",
    ]
    for number in range(len(REGIONS)):
        chosen = judged.regions == number
        both = (decibels(each[chosen].mean()) for each in (errors, references_too))
        cells.append(" / ".join(both) if chosen.mean() > 1e-3 else "")
    return cells


def time_view(measured: MeasuredScene, rows: int, passes: int = 24) -> float:
    """Seconds that SPPM with :data:`STANDARD` passes takes for a view, from some of its passes."""
    renderer = sppm(measured.scene, measured.sensors([measured.own], rows))
    sums = renderer.empty_sums()
    spent = []
    for k in range(passes):
        start = time.perf_counter()
        renderer.run_pass(1 + k * STANDARD // passes, sums)
        spent.append(time.perf_counter() - start)
    return STANDARD * float(np.median(spent[2:]))  # the first ones compile


def frame(
    scenes: cli.Scenes = None,
    seconds: cli.Seconds = 120,
    rows: cli.Rows = 512,
    reference_passes: cli.ReferencePasses = 100,
    kept: cli.Kept = cli.KEPT,
) -> None:
    """Time and quality of one novel view, for several numbers of samples, denoised and not.

    The field is fitted with the scene's training views. PSNR is against a truth with narrow
    kernels; the title has that of SPPM with 300 passes, whose kernels are those of 1000.
    """
    for name in scenes or list_scenes():
        measured = open_scene(name)
        judged = judge_views(measured, rows, reference_passes, kept, count=1)
        field = kept_field(measured, seconds, kept)
        asked = decibels(judged.reference_errors(FRAME_PASSES).mean())
        title = f"{name}: SPPM, {FRAME_PASSES} passes: {asked}"
        table = Table("samples", "seconds", "PSNR", title=title)
        for spp, denoise in SAMPLES:
            settings = RenderSettings(spp=spp, denoise=denoise)
            picture = partial(measured.render, field, judged.views, rows, settings)
            spent, images = time_of(picture), picture()
            label = f"{spp}, denoised" if denoise else f"{spp}"
            table.add_row(label, f"{spent:.2f}", decibels(judged.truth.errors(images).mean()))
        Console(width=100).print(table)

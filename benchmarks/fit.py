"""`python -m benchmarks.fit [--seconds S … | --times T | --passes N] [SCENE …]`: `gpf.fit` alone.

The scenes are those of `scenes/` and of `benchmarks/check_scenes.py`. The fit places its own
cameras; with `--views training` it gets the scene's training views and exposure, with
`--views judged` the judged views too, as the command `gpf fit` takes them from a file. The judged
views are the novel views of `scenes/`, or frames of the path that `gpf scene import` would place.
With `--times T`, the fit takes T times as long as SPPM with 1000 passes takes for a view.

There is one line per scene and goal, with the time of such a view, and the views' mean PSNR

- as estimated by the fit, and of the rendered field against SPPM with 1000 passes, at the exposure
  that the fit has chosen, and at that of the scene's views;
- of a second SPPM with 1000 passes against the first;
- of the field and of SPPM with 1000 passes against the truth, and over all pixels of a region
  (:mod:`benchmarks.regions`).

References are those of :mod:`benchmarks.judged`, kept in a folder for the next run.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import mitsuba as mi
import numpy as np
from rich.console import Console
from rich.table import Table

import gpf
from benchmarks.check_scenes import SCENES
from benchmarks.judged import (
    STANDARD,
    Judged,
    Kept,
    decibels,
    judged_views,
    mean_psnr,
    references,
    render,
    training_views,
)
from benchmarks.placement import open_scene
from benchmarks.regions import REGIONS
from gpf.core.progress import progress_bar
from gpf.field.field import GaussianPhotonField
from gpf.guiding.emission_plan import EmissionPlan, VisibleRegionSettings
from gpf.scene.folders import list_scenes
from gpf.scene.sensors import make_sensor
from gpf.sppm.reference import ReferenceRenderer, ReferenceSettings

ROWS = 256


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    goal = parser.add_mutually_exclusive_group()
    goal.add_argument("--seconds", type=float, nargs="+")
    goal.add_argument("--times", type=float)
    goal.add_argument("--passes", type=int)
    parser.add_argument("--views", choices=("training", "judged"))
    parser.add_argument("--reference-passes", type=int, default=200)
    parser.add_argument("--references", type=Path, default=Path("results/benchmark_references"))
    parser.add_argument("scenes", nargs="*", default=[*list_scenes(), *SCENES])
    arguments = parser.parse_args()
    columns = (
        "passes",
        "s",
        "SPPM s",
        "Gaussians",
        "estimated",
        "fit's exposure",
        "measured",
        "second SPPM",
        "truth",
    )
    table = Table("scene", *columns, *REGIONS)
    for name in arguments.scenes:
        for cells in judge(name, arguments):
            table.add_row(name, *cells)
            Console(width=190).print(table)


def judge(name: str, arguments: argparse.Namespace) -> Iterator[list[str]]:
    """Fit fields to a scene, and compare their images with references; the cells of each line."""
    scene, own, aspect = open_scene(name)
    views, exposure = judged_views(name, scene, own, aspect)
    size = round(ROWS * aspect), ROWS
    kept = Kept(arguments.references, arguments.reference_passes)
    judged = references(name, scene, views, size, exposure, kept)
    sensors = None
    if arguments.views:
        views = training_views(name, own)
        views += judged.views if arguments.views == "judged" else []
        sensors = [make_sensor(view, *judged.size) for view in views]
    view = time_view(scene, make_sensor(own, *judged.size))
    known = exposure if arguments.views else None
    goals = [arguments.times * view] if arguments.times else arguments.seconds or [None]
    for seconds in goals:
        with progress_bar(f"{name}: fit", 1):
            field = gpf.fit(
                scene, sensors, seconds=seconds, passes=arguments.passes, exposure=known
            )
        yield describe(field, render(scene, field, judged), judged, view)


def describe(
    field: GaussianPhotonField, images: np.ndarray, judged: Judged, view: float
) -> list[str]:
    """The cells of a line; ``view``: seconds that SPPM takes for a view."""
    record, references_too = field.record, judged.reference_errors()
    errors = judged.errors(images)
    so_exposed = replace(judged, exposure=record["exposure"])
    cells = [
        str(record["passes"]),
        f"{record['seconds']:.0f}",
        f"{view:.0f}",
        str(len(field.gaussians.means.numpy().T)),
        f"{record['estimated_psnr']:.1f}",
        mean_psnr(so_exposed.differences(images)),
        mean_psnr(judged.differences(images)),
        mean_psnr(2 * judged.noise(STANDARD)),
        f"{mean_psnr(errors)} / {mean_psnr(references_too)}",
    ]
    for number in range(len(REGIONS)):
        chosen = judged.regions == number
        both = (decibels(each[chosen].mean()) for each in (errors, references_too))
        cells.append(" / ".join(both) if chosen.mean() > 1e-3 else "")
    return cells


def time_view(scene: mi.Scene, sensor: mi.Sensor, passes: int = 24) -> float:
    """Seconds that SPPM with :data:`STANDARD` passes takes for a view, from some of its passes."""
    plan = EmissionPlan.make(scene, [sensor], VisibleRegionSettings())
    settings = ReferenceSettings().measure(scene, sensor, plan)
    renderer = ReferenceRenderer(scene, {"own": sensor}, {}, settings, 0, plan.source)
    sums = renderer.empty_sums()
    spent = []
    for k in range(passes):
        start = time.perf_counter()
        renderer.run_pass(1 + k * STANDARD // passes, sums)
        spent.append(time.perf_counter() - start)
    return STANDARD * float(np.median(spent[2:]))  # the first ones compile


if __name__ == "__main__":
    from gpf.core.runtime import choose_variant

    choose_variant("auto")
    main()

"""Further judges of the images that `dvc repro` has left."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from benchmarks import cli
from benchmarks.judged import KERNELS
from benchmarks.truth import keep, radiance_pairs, sppm_images, trace_paths
from gpf.core.files import write_text
from gpf.core.images import read_exr
from gpf.scene.folders import list_scenes
from metrics.halves import Halves
from metrics.image import flip_exposures, lpips
from report.results import Results
from stages.common.workspace import Workspace
from stages.config.titles import method_titles
from stages.metrics import Judge

SHOWN = ("psnr", "ssim", "lpips", "flip")
METHODS = ("gpf", "radiance_cache", "second_reference")


def truth(
    scene: str,
    views: Annotated[
        list[str] | None, typer.Argument(metavar="[VIEW]…", help="[default: all novel views]")
    ] = None,
    samples: cli.Samples = 8192,
) -> None:
    """Field and SPPM against a path tracer, in a scene whose light that can find.

    The noise of the references counts as an error of other methods. The path-traced image is
    independent of the field and of SPPM, and less noisy.
    """
    work = Workspace.open(scene)
    judge = Judge.open(work)
    for view in views or list(judge.references):
        sensor = work.sensor(work.views.find(view))
        true = trace_paths(f"{scene}, {view}", work.load_scene(), sensor, samples)
        path_judge = Judge(work, {view: true}, flip_exposures([true]))
        images = {
            "the reference": judge.references[view],
            "a second SPPM": shown(work, "second_reference", view),
            "GPF": shown(work, "gpf", view),
        }
        table = Table("", *SHOWN, title=f"{scene}, {view}: against `path`, {samples} spp")
        for title, image in images.items():
            found = path_judge.compare(view, image)
            table.add_row(title, *(f"{found[key]:.3f}" for key in SHOWN))
        Console(width=120).print(table)


def independent(
    scenes: cli.ProjectScenes = None,
    passes: cli.ReferencePasses = 1000,
    views: Annotated[int, typer.Option(min=1, help="Number of novel views.")] = 2,
    kept: cli.Kept = cli.KEPT,
) -> None:
    """Which images are nearer the truth, by a judge that shares nothing with them.

    The published tables compare all systems with references from which some of them have learned,
    or whose kernels they share. Here, each view is judged by two further SPPM images, with photons
    of their own and the kernels of 4000 passes. The table goes to results/independent.md, from
    where `python docs/publish.py` takes it. The images are kept; a second run takes seconds.
    """
    lines = [
        "| | PSNR ↑ | relMSE ↓ | LPIPS ↓, judge of 1000 passes | of 2000 | of 4000 |",
        "|---|---|---|---|---|---|",
    ]
    for name in scenes or list_scenes():
        work = Workspace.open(name)
        halves = judging_halves(work, views, passes, kept)
        lines.append(f"| **{Results.open().scene(name).title}** | | | | | |")
        lines += [row(work, method, halves) for method in METHODS]
        print(*lines[-1 - len(METHODS) :], sep="\n", flush=True)
    write_text(Path("results/independent.md"), "\n".join(["# Another judge", "", *lines, ""]))


def judging_halves(work: Workspace, views: int, passes: int, kept: Path) -> dict[str, Halves]:
    """Two images of each of the first novel views."""
    chosen = work.novel_views()[:views]

    def make() -> dict[str, np.ndarray]:
        sensors = [work.sensor(view) for view in chosen]
        scene, kernels = work.load_scene(), KERNELS["long"]
        return {"images": radiance_pairs(sppm_images(work.scene, scene, sensors, passes, kernels))}

    file = kept / f"{work.scene}_independent_{work.film_size[1]}_{views}_{passes}.npz"
    images = keep(file, make)["images"]
    return {view.name: Halves(*pair) for view, pair in zip(chosen, images, strict=True)}


def row(work: Workspace, method: str, halves: dict[str, Halves]) -> str:
    """A line of the table: means over the views.

    A judge's noise affects LPIPS, so there are judges with less and less: one image, the mean of
    both, and the mean of both, the reference and the second reference.
    """
    exposure, epsilon = work.views.exposure, work.params.metrics.relmse_epsilon
    numbers = []
    for view, pair in halves.items():
        image, level = shown(work, method, view), read_exr(work.reference(view))[0]["radiance"]
        images = [pair.first, pair.second, level, shown(work, "second_reference", view)]
        judges = [np.mean(images[:count], axis=0) for count in (1, 2, 4)]
        apart = [lpips(image, judged, exposure) for judged in judges]
        numbers.append((pair.psnr(image, exposure), pair.relmse(image, level, epsilon), *apart))
    psnr, relmse, *apart = np.mean(numbers, axis=0)
    title = method_titles(work.params)[method]
    cells = [f"{value:.3f}" for value in apart]
    if method == "second_reference":
        cells[-1] = "–"  # it is one of the judge's images
    return f"| {title} | {psnr:.2f} | {relmse:.5f} | {' | '.join(cells)} |"


def shown(work: Workspace, method: str, view: str) -> np.ndarray:
    """A method's image of a view, (H, W, 3)."""
    if method != "second_reference":
        return read_exr(work.render(method, view))[0]["radiance"]
    layers, _ = read_exr(work.second_reference(view))
    passes = max(int(name.removeprefix("sppm_")) for name in layers)
    return layers[f"sppm_{passes}"]

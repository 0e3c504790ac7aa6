"""`python -m benchmarks.frame [--seconds S] [SCENE …]`: a picture of 512 rows and what it takes.

A field is fitted for S seconds with the scene's training views. Then one novel view is rendered
from it with more and more samples per pixel, denoised and not, each twice: the first time compiles.
Each picture has its seconds, and its PSNR against the truth (:mod:`benchmarks.judged`), beside that
of SPPM with 300 passes, whose kernels count as those of 1000.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks.judged import Kept, decibels, judged_views, kept_field, references, render
from benchmarks.placement import open_scene
from gpf.rendering.settings import RenderSettings
from gpf.scene.folders import list_scenes

ROWS, PASSES = 512, 300
SAMPLES = ((1, True), (2, True), (4, True), (8, True), (16, True), (16, False), (64, False))


def main() -> None:
    """Print one table per scene."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=120)
    parser.add_argument("--reference-passes", type=int, default=100)
    parser.add_argument("--kept", type=Path, default=Path("results/benchmark_references"))
    parser.add_argument("scenes", nargs="*", default=list_scenes())
    arguments = parser.parse_args()
    for name in arguments.scenes:
        Console(width=100).print(judge(name, arguments))


def judge(name: str, arguments: argparse.Namespace) -> Table:
    """A line for each number of samples."""
    scene, own, aspect = open_scene(name)
    views, exposure = judged_views(name, scene, own, aspect)
    size = round(ROWS * aspect), ROWS
    kept = Kept(arguments.kept, arguments.reference_passes)
    judged = replace(references(name, scene, views[:1], size, kept), exposure=exposure)
    field = kept_field(name, scene, [own], aspect, arguments.seconds, kept)
    asked = decibels(judged.reference_errors(PASSES).mean())
    table = Table("samples", "seconds", "PSNR", title=f"{name}: SPPM with {PASSES} passes {asked}")
    for spp, denoise in SAMPLES:
        settings = RenderSettings(spp=spp, denoise=denoise)
        for _ in range(2):
            start = time.perf_counter()
            images = render(scene, field, judged, settings)
            seconds = time.perf_counter() - start
        label = f"{spp}, denoised" if denoise else f"{spp}"
        table.add_row(label, f"{seconds:.2f}", decibels(judged.errors(images).mean()))
    return table


if __name__ == "__main__":
    from gpf.core.runtime import choose_variant

    choose_variant("auto")
    main()

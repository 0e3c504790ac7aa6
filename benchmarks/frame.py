"""`python -m benchmarks.frame [--seconds S] [SCENE …]`: a 512-row picture's time and quality.

A field is fitted for S seconds with the scene's training views. Then one novel view is rendered
from it with more and more samples per pixel, denoised and not, each twice: the first time compiles.
The table has each picture's seconds and PSNR against the truth (:mod:`benchmarks.judged`); its
title has the PSNR of SPPM with 300 passes and the kernels of 1000.
"""

from __future__ import annotations

import argparse
import time

from rich.console import Console
from rich.table import Table

from benchmarks.judged import decibels, open_field, options, render
from gpf.rendering.settings import RenderSettings

ROWS, PASSES = 512, 300
SAMPLES = ((1, True), (2, True), (4, True), (8, True), (16, True), (16, False), (64, False))


def main() -> None:
    """Print one table per scene."""
    arguments = options(__doc__.splitlines()[0], passes=100).parse_args()
    for name in arguments.scenes:
        Console(width=100).print(judge(name, arguments))


def judge(name: str, arguments: argparse.Namespace) -> Table:
    """A line for each number of samples."""
    scene, field, judged = open_field(name, ROWS, 1, arguments)
    asked = decibels(judged.reference_errors(PASSES).mean())
    table = Table("samples", "seconds", "PSNR", title=f"{name}: SPPM, {PASSES} passes: {asked}")
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

"""`python -m benchmarks.equal_quality SCENE …`: SPPM's time for images as good as the field's.

Needs the results of `dvc repro`. The novel views are rendered from the field with several numbers
of samples, without and with the denoiser (`pyoidn`). SPPM's convergence on the same views gives the
number of passes of equal quality. Both are timed alternately, so that other load affects both.
"""

from __future__ import annotations

import sys
import time
from itertools import product

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.single_passes import SinglePasses
from gpf.rendering.denoiser import available
from metrics.equivalent_passes import equivalent_passes
from metrics.image import psnr
from stages.amortize import mean_convergence
from stages.common.workspace import Workspace
from stages.metrics import Judge
from stages.render import open_renderer

SAMPLES = (4, 16, 32, 64)


def main() -> None:
    """Print one table per scene."""
    console = Console(width=120)
    for name in sys.argv[1:]:
        work = Workspace.open(name)
        table = Table("spp", "PSNR", "s per view", "equivalent passes", "s per pass", "ratio")
        table.title = name
        for row in compare(work):
            table.add_row(*row)
        console.print(table)


def compare(work: Workspace) -> list[list[str]]:
    """A row for each number of samples."""
    passes, curve, rows = SinglePasses(work), mean_convergence(work), []
    references = Judge.open(work).references
    for spp, denoise in product(SAMPLES, (False, True) if available() else (False,)):
        renderer = open_renderer(work, spp)
        renderer.integrator.denoise = denoise
        renderer.render(work.views.novel[0], work.film_size, 0)  # compiles
        quality, seconds, per_pass = [], [], []
        for k, view in enumerate(work.views.novel):
            start = time.perf_counter()
            seed = work.params.render.seed + k
            image = renderer.render(view, work.film_size, seed)["radiance"]
            seconds.append(time.perf_counter() - start)
            per_pass.append(passes.seconds(len(work.views.novel), k))
            quality.append(psnr(image, references[view.name], work.views.exposure))
        equal = equivalent_passes(float(np.mean(quality)), curve)
        mine, theirs = float(np.mean(seconds)), float(np.mean(per_pass))
        rows.append(
            [
                f"{spp}, denoised" if denoise else str(spp),
                f"{np.mean(quality):.2f}",
                f"{mine:.2f}",
                str(equal),
                f"{theirs:.4f}",
                f"{equal.bound}{equal.passes * theirs / mine:.0f}",
            ]
        )
    return rows


if __name__ == "__main__":
    main()

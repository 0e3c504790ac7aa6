"""`python -m benchmarks.equal_quality SCENE …`: what SPPM takes for images as good as the field's.

After `dvc repro`. Every novel view comes from the field at several numbers of samples; SPPM's
convergence on the same views says how many passes are as good; and both are timed in turns, in this
process, so that other load on the machine meets both.
"""

from __future__ import annotations

import sys
import time

import gpf  # noqa: F401  (first: it tells Dr.Jit where libLLVM is)
from gpf.core.runtime import choose_variant

choose_variant("auto")

import numpy as np  # noqa: E402
from rich.console import Console  # noqa: E402
from rich.table import Table  # noqa: E402

from benchmarks.single_passes import SinglePasses  # noqa: E402
from gpf.core.images import read_exr  # noqa: E402
from metrics.equivalent_passes import equivalent_passes  # noqa: E402
from metrics.image import psnr  # noqa: E402
from stages.amortize import mean_convergence  # noqa: E402
from stages.common.workspace import Workspace  # noqa: E402
from stages.render import FieldRenderer  # noqa: E402

SAMPLES = (4, 16, 32, 64)


def main() -> None:
    """Print one table per scene."""
    console = Console(width=120)
    for name in sys.argv[1:]:
        work = Workspace.open(name)
        table = Table("spp", "PSNR", "s per view", "SPPM passes as good", "s per pass", "ratio")
        table.title = name
        for row in compare(work):
            table.add_row(*row)
        console.print(table)


def compare(work: Workspace) -> list[list[str]]:
    """A row for each number of samples."""
    passes, curve = SinglePasses(work), mean_convergence(work)
    rows = []
    for spp in SAMPLES:
        renderer = FieldRenderer.open(work, work.params.film.height, spp)
        renderer.render(work.views.novel[0], 0)  # compiles
        quality, seconds, per_pass = [], [], []
        for k, view in enumerate(work.views.novel):
            start = time.perf_counter()
            image = renderer.render(view, work.params.render.seed + k).radiance
            seconds.append(time.perf_counter() - start)
            per_pass.append(passes.seconds(len(work.views.novel), k))
            reference = read_exr(work.reference(view.name))[0]["radiance"]
            quality.append(psnr(image, reference, work.views.exposure))
        worth = equivalent_passes(float(np.mean(quality)), curve)
        mine, theirs = float(np.mean(seconds)), float(np.mean(per_pass))
        rows.append(
            [
                str(spp),
                f"{np.mean(quality):.2f}",
                f"{mine:.2f}",
                str(worth),
                f"{theirs:.4f}",
                f"{worth.bound}{worth.passes * theirs / mine:.0f}",
            ]
        )
    return rows


if __name__ == "__main__":
    main()

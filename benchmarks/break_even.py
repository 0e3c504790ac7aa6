"""`python -m benchmarks.break_even SCENE …`: the view from which the field pays, at equal quality.

Needs the results of `dvc repro`. Where the field is better than the second reference, that SPPM is
continued from its last pass until it is as good as the field, up to three times as many passes. The
field's preparation and views are compared with views by this SPPM, each rendered alone or together.
The images are kept in results/benchmark_references.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from gpf.core.files import read_json
from gpf.core.images import read_exr
from gpf.core.progress import progress_bar
from gpf.scene.folders import list_scenes
from metrics.cost import SPPM, SPPM_TOGETHER, CostLine, break_even
from metrics.equivalent_passes import equivalent_passes
from metrics.files import Judged
from metrics.image import psnr
from stages.amortize import cost_lines, mean_convergence
from stages.common.workspace import Workspace
from stages.metrics import Judge
from stages.references.groups import Group, GroupRequest, Job

STEPS, LONGEST = 4, 3
"""Images per length of the second reference, and the upper limit in such lengths."""


def main() -> None:
    """Print a row per scene."""
    parser = argparse.ArgumentParser(description="The view from which the field pays")
    parser.add_argument("--kept", type=Path, default=Path("results/benchmark_references"))
    parser.add_argument("scenes", nargs="*", default=list_scenes())
    arguments = parser.parse_args()
    table = Table("", "field's PSNR", "SPPM passes", "pays from, alone", "together")
    for name in arguments.scenes:
        table.add_row(name, *compare(Workspace.open(name), arguments.kept))
        Console(width=120).print(table)


def compare(work: Workspace, kept: Path) -> list[str]:
    """The cells of a scene's row."""
    quality = read_json(work.metrics("gpf"), Judged)["mean"]["psnr"]
    curve = mean_convergence(work)
    if quality > max(curve.values()):
        curve = curve | longer_curve(work, kept, quality)
    equal, lines = equivalent_passes(quality, curve), cost_lines(work)
    counts = []
    for line in lines.others:
        if line.name in (SPPM, SPPM_TOGETHER):
            seconds = line.per_view_seconds / lines.passes * equal.passes
            counts.append(str(break_even(lines.field, CostLine(line.name, 0, seconds))))
    return [f"{quality:.2f}", str(equal), *counts]


def longer_curve(work: Workspace, kept: Path, quality: float) -> dict[int, float]:
    """Number of passes -> mean PSNR of the continued second reference, until ``quality``."""
    passes = work.params.reference.passes
    group = Group(Job.open(work), "second_reference")
    names = [view.name for view in group.views]
    renderer = group.open(GroupRequest(group.name, tuple(names), False)).renderer
    key = f"sppm_{passes}"
    mean = np.array([read_exr(group.file(name))[0][key] for name in names], np.float64)
    judge, curve = Judge.open(work), {}
    length = passes // STEPS
    with progress_bar(f"{work.scene}: SPPM continues", (LONGEST - 1) * passes) as bar:
        for first in range(passes, LONGEST * passes, length):
            last = first + length
            file = kept / f"{work.scene}_{work.film_size[1]}_second_{first}_{last}.npz"
            if not file.exists():
                sums = renderer.empty_sums()
                for t in range(first, last):
                    renderer.run_pass(t + 1, sums)
                    bar(t + 1 - passes)
                kept.mkdir(parents=True, exist_ok=True)
                images = np.array([renderer.image(name, sums) for name in names])
                np.savez_compressed(file, images=images)
            with np.load(file) as stored:
                mean += (stored["images"] - mean) * (length / last)
            pairs = zip(mean, (judge.references[name] for name in names), strict=True)
            curve[last] = float(np.mean([psnr(*pair, work.views.exposure) for pair in pairs]))
            if curve[last] > quality:
                break
    return curve


if __name__ == "__main__":
    main()

"""Stage `amortize`: cost of n views with all preparation, and the field's break-even n."""

from __future__ import annotations

from dataclasses import dataclass

import pandas as pd

from gpf.core.errors import UserError
from gpf.core.files import read_json, write_json, write_text
from gpf.core.progress import say
from metrics.cost import (
    GPF,
    SPPM,
    SPPM_AT_EQUAL_QUALITY,
    SPPM_TOGETHER,
    CostLine,
    break_even,
    cumulative,
)
from metrics.equivalent_passes import equivalent_passes
from metrics.files import CostFile, Judged, Point
from metrics.stage_costs import part_seconds, passes_done, seconds_per_view, target_seconds
from stages.common.costs import KINDS, times_of
from stages.common.workspace import Workspace


@dataclass(frozen=True)
class Comparison:
    """The field's cost line and the lines of SPPM.

    Attributes
    ----------
    passes: SPPM passes of the reference.
    equal_passes: SPPM passes that reach the field's PSNR, as text; may be a bound (``>1000``).
    """

    field: CostLine
    others: tuple[CostLine, ...]
    passes: int
    equal_passes: str


def cost_lines(work: Workspace) -> Comparison:
    """Cost lines from the stages' cost files (wall-clock seconds without compilation).

    Raises
    ------
    UserError: a file is missing or has another shape, or a cost file lacks a time.
    """
    reference, photons, train, render = (
        read_json(work.cost(stage), CostFile)
        for stage in ("reference", "photons", "train", "render")
    )
    curve = mean_convergence(work)
    passes = max(curve)
    quality = read_json(work.metrics("gpf"), Judged)["mean"]["psnr"]
    equal = equivalent_passes(quality, curve)
    preparation = part_seconds(train, *train["parts"])
    with times_of(work.cost("reference")):
        if "stream" not in train["parts"]:
            # The field needs only the targets. The stage also renders images of the training views
            # for other methods; this sum leaves them out.
            done = passes_done(reference, "train", work.params.reference.passes)
            preparation += part_seconds(photons, *photons["parts"])
            preparation += target_seconds(reference, done)
        alone, together = (
            reference["facts"][f"seconds_per_{kind}_view_pass"] for kind in ("single", "shared")
        )
    with times_of(work.cost("render")):
        field = CostLine(GPF, preparation, seconds_per_view(render))
    return Comparison(
        field,
        (
            CostLine(SPPM, 0.0, passes * alone),
            CostLine(SPPM_AT_EQUAL_QUALITY, 0.0, equal.passes * alone),
            # Only possible if all views are known in advance. The field does not need this.
            CostLine(SPPM_TOGETHER, 0.0, passes * together),
        ),
        passes,
        str(equal),
    )


def mean_convergence(work: Workspace) -> dict[int, float]:
    """Number of SPPM passes -> PSNR against the reference in dB, mean over novel views."""
    rows = read_json(work.convergence, list[Point])
    if not rows:
        raise UserError(
            str(work.convergence),
            "is empty: there were no second references",
            f"Run `gpf stage reference --scene {work.scene}`, then `gpf stage metrics`.",
        )
    return {row["passes"]: row["psnr"] for row in rows}


def seconds_of_all(work: Workspace) -> pd.DataFrame:
    """Wall-clock, CPU and compilation seconds; a row for each part of each stage that has run."""
    folder = work.cost("scene").parent
    rows = [
        {"stage": stage, "part": name, **part}
        for path in sorted(folder.rglob("*.json"))
        for stage in [path.relative_to(folder).with_suffix("").as_posix()]
        for name, part in read_json(path, CostFile)["parts"].items()
    ]
    return pd.DataFrame(rows, columns=["stage", "part", *KINDS])


def run(scene_name: str) -> None:
    """Write the cost tables and print the number of views from which the field is cheaper."""
    work = Workspace.open(scene_name)
    lines, seconds = cost_lines(work), seconds_of_all(work)
    write_text(work.all_costs, seconds.to_csv(index=False))
    table = cumulative([lines.field, *lines.others], range(1, work.params.amortize.views + 1))
    long = table.melt("views", var_name="system", value_name="seconds")  # for `dvc plots`
    write_text(work.folder / "cost.csv", long.to_csv(index=False))
    counts = {other.name: break_even(lines.field, other) for other in lines.others}
    write_json(
        work.folder / "amortize.json",
        {
            "break_even_views": counts,
            "passes": {SPPM: lines.passes, SPPM_AT_EQUAL_QUALITY: lines.equal_passes},
            "preparation_seconds": lines.field.preparation_seconds,
            "seconds_per_view": {
                line.name: line.per_view_seconds for line in (lines.field, *lines.others)
            },
        },
    )
    for name, count in counts.items():
        passes = lines.equal_passes if name == SPPM_AT_EQUAL_QUALITY else lines.passes
        views = "never" if count is None else f"from view {count} on"
        say(f"{scene_name}: GPF costs less than {name} ({passes} passes): {views}")

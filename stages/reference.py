"""Stage `reference`: SPPM references of all views, and the targets that training learns from.

A view whose file was made by the same scene, camera and parameters is left alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gpf.core.errors import UserError
from gpf.core.files import read_tensors, write_tensors
from gpf.core.images import check_finite, read_exr, write_exr
from gpf.core.progress import say
from gpf.core.structs import to_numpy
from gpf.scene.views import View
from gpf.sppm.pass_sums import PassSums
from gpf.training.targets import SURFACES, Targets
from metrics.equivalent_passes import snapshot_passes
from stages.common.publishing import make_ready, settle
from stages.common.workspace import Workspace
from stages.references.groups import (
    GROUPS,
    GroupRequest,
    Job,
    open_group,
    record_of,
    views_of,
)
from stages.references.long_sums import LongSum
from stages.references.pass_times import time_kinds_of_passes
from stages.references.records import (
    has_surfaces,
    is_current,
    passes_done,
    surface_record,
    view_record,
)


def render_references(scene_name: str, passes: str | None = None) -> None:
    """Render what is missing of the references, the second reference and the targets.

    ``passes``, written ``FIRST:LAST``, limits that to a range of passes, which other runs or other
    machines complete; files are written once all passes are there.
    """
    job = Job.open(Workspace.open(scene_name))
    work, costs = job.work, job.costs
    wanted = _parse_range(passes, work.params.reference.passes) if passes else None
    rendered = [_render_group(job, group, wanted) for group in GROUPS]
    if None in rendered:
        missing = ", ".join(g for g, state in zip(GROUPS, rendered, strict=True) if state is None)
        say(
            f"{scene_name}: passes {passes} are done, others are missing ({missing}); bring their "
            "files here, or run the stage without --passes"
        )
        return
    done = {g: passes_done(work, g, views_of(work, g)) for g in GROUPS}
    if any(rendered) or "seconds_per_shared_view_pass" not in costs.facts:
        costs.facts |= time_kinds_of_passes(job, max(done.values()))
    costs.facts["passes_done"] = done
    costs.facts |= job.settings.model_dump() | {"seed": work.params.reference.seed}
    costs.facts |= job.plan.facts()
    costs.write(work.cost("reference"))


def _parse_range(text: str, passes: int) -> range:
    """``FIRST:LAST`` like a slice; both ends may be left out."""
    first, colon, last = text.partition(":")
    numbers = (first or "0", last or str(passes))
    if not colon or not all(number.isdecimal() for number in numbers):
        raise UserError(
            f"--passes {text}", "is no range of passes", "Write it as FIRST:LAST, such as 0:250."
        )
    found = range(int(numbers[0]), int(numbers[1]))
    if not found or found.stop > passes:
        raise UserError(
            f"--passes {text}",
            f"is not within the {passes} passes of params.yaml",
            "Give a range within them, or change reference.passes.",
        )
    return found


def _render_group(job: Job, group: str, wanted: range | None) -> bool | None:
    """Render what is missing of a group; whether anything was. None: passes are still missing."""
    work = job.work
    for folder in work.parts("reference", group).glob("*"):
        settle(folder, work.folder)
    work.forget_checkpoints()
    record = record_of(job, group)
    views = views_of(work, group)
    missing = [view for view in views if not is_current(work, group, view, record)]
    surfaces = group == "train" and work.params.reference.surface_points > 0
    surfaces_missing = surfaces and not has_surfaces(work, record)
    if missing or surfaces_missing:
        request = GroupRequest(group, tuple(view.name for view in missing), surfaces_missing)
        passes = open_group(job, request)
        for folder, difference in passes.parts.others().items():
            say(f"{folder}: made with {difference}; left alone")
        wanted = range(passes.passes) if wanted is None else wanted
        if work.params.executor == "ray":
            # Here alone: Ray is optional, and slow to import.
            from stages.references.cluster import render_on_cluster

            render_on_cluster(passes, request, wanted)
        else:
            passes.render(wanted)
        counts = snapshot_passes(passes.passes) if group == "second_reference" else []
        finished = passes.finish(counts)
        if finished is None:
            return None
        _write_group(passes, missing, record, *finished)
    if group == "train":
        _collect_targets(work, views, surfaces)
    return bool(missing or surfaces_missing)


def _write_group(
    passes: LongSum,
    views: Sequence[View],
    record: dict[str, Any],
    sums: PassSums,
    snapshots: dict[str, dict[str, np.ndarray]],
) -> None:
    """Write the files of a group whose passes are all there, and forget the parts."""
    work, group, renderer = passes.work, passes.group, passes.renderer
    passes.costs.share(group, sorted({*renderer.sensors, *renderer.points}))

    def write(folder: Path) -> None:
        for view in views:
            if group == "second_reference":
                path, layers = work.second_reference(view.name), snapshots[view.name]
            else:
                path = work.reference(view.name)
                layers = renderer.view(view.name, sums, work.film_size).layers()
            for name, image in layers.items():
                if image.ndim == 3:
                    check_finite(image, f"{work.scene}, view {view.name}, {name}")
            facts = view_record(record, view) | _noise(passes, sums, view.name)
            write_exr(folder / path.relative_to(work.folder), layers, facts)
        if SURFACES in renderer.points:
            points = renderer.points[SURFACES]
            tensors = {
                "position": to_numpy(points.p),
                "normal": to_numpy(points.n),
                "irradiance": renderer.mean_irradiance(SURFACES, sums),
                "direct": renderer.mean_direct(SURFACES, sums),
            }
            path = folder / work.surfaces.relative_to(work.folder)
            write_tensors(path, "surfaces", tensors, surface_record(work, record))

    make_ready(passes.parts.folder, write)
    passes.parts.clear()
    settle(passes.parts.folder, work.folder)
    work.forget_checkpoints()


def _noise(passes: LongSum, sums: PassSums, view: str) -> dict[str, Any]:
    """How much noise is left in a view's image, for its record."""
    if view not in sums.views:
        return {}
    tally = sums.views[view]
    error, mean = tally.standard_error(sums.passes), tally.mean(sums.passes)
    return {
        "passes_done": sums.passes,
        "standard_error": float(np.sqrt(np.mean(error**2)) / max(np.mean(mean), 1e-30)),
        "expected_psnr": tally.expected_psnr(sums.passes, passes.work.views.exposure),
    }


def _collect_targets(work: Workspace, views: Sequence[View], surfaces: bool) -> None:
    """Write the supervised points of all training views and surfaces into one file."""
    parts = []
    for k, view in enumerate(views):
        layers, _ = read_exr(work.reference(view.name))
        parts.append(Targets.from_view(layers, k))
    if surfaces:
        tensors, _ = read_tensors(work.surfaces, "surfaces")
        parts.append(Targets.from_surfaces(tensors))
    Targets.join(parts).save(work.targets)

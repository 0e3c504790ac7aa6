"""Stage `reference`: SPPM references of all views, and the training targets.

Each group of views (:mod:`stages.references.groups`) is rendered in five steps:

1. :meth:`Group.missing`: which files are missing or out of date; the others stay as they are.
2. :meth:`Group.open`: the renderer, and the parts that earlier runs or other machines made.
3. :meth:`GroupPasses.render`, or :func:`render_on_cluster`: the missing passes, saved in parts.
4. :meth:`GroupPasses.finish`: the exact sum of all parts; None while passes are missing.
5. :func:`_write_files`: all files of the group at once; then the parts are removed.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from gpf.core.errors import UserError
from gpf.core.files import read_tensors, require_finite, write_tensors
from gpf.core.images import check_finite, read_exr, write_exr
from gpf.core.progress import say
from gpf.core.structs import to_numpy
from gpf.training.targets import SURFACES
from metrics.equivalent_passes import snapshot_passes
from stages.common.publishing import prepare_files, publish_files
from stages.common.workspace import Workspace
from stages.references.group_passes import GroupPasses
from stages.references.groups import GROUPS, Group, GroupRequest, Job
from stages.references.pass_sums import PassSums
from stages.references.pass_times import time_kinds_of_passes
from stages.references.targets import join, save, targets_of_surfaces, targets_of_view


def run(scene_name: str, passes: str | None = None) -> None:
    """Render the missing references, second references and targets.

    ``passes``, written ``FIRST:LAST``, limits this to a range of passes; other runs or
    machines render the rest. Files are written once all passes are done.
    """
    job = Job.open(Workspace.open(scene_name))
    work, costs = job.work, job.costs
    wanted = _parse_range(passes or ":", work.params.reference.passes)
    groups = [Group(job, name) for name in GROUPS]
    rendered, incomplete = False, []
    for group in groups:
        _publish_files_of_killed_run(group)
        if request := group.missing():
            if not _render(group, request, wanted):
                incomplete.append(group.name)
                continue
            rendered = True
        if group.name == "train":
            _collect_targets(group)
    if incomplete:
        say(
            f"{scene_name}: passes {passes} are done, but others are missing "
            f"({', '.join(incomplete)}); copy their files here, or run the stage without --passes"
        )
        return
    done = {group.name: group.passes_done() for group in groups}
    if rendered or "seconds_per_shared_view_pass" not in costs.facts:
        costs.facts |= time_kinds_of_passes(job, max(done.values()))
    costs.facts["passes_done"] = done
    costs.facts |= job.settings.model_dump() | {"seed": work.params.reference.seed}
    costs.facts |= job.plan.facts()
    costs.write(work.cost("reference"))


def _parse_range(text: str, passes: int) -> range:
    """Parse ``FIRST:LAST``, whose ends are optional, as in a slice."""
    first, colon, last = text.partition(":")
    numbers = (first or "0", last or str(passes))
    if not colon or not all(number.isdecimal() for number in numbers):
        raise UserError(
            f"--passes {text}", "is not a range of passes", "Write it as FIRST:LAST, such as 0:250."
        )
    found = range(int(numbers[0]), int(numbers[1]))
    if not found or found.stop > passes:
        raise UserError(
            f"--passes {text}",
            f"is not within the {passes} passes of params.yaml",
            "Give a range within them, or change reference.passes.",
        )
    return found


def _publish_files_of_killed_run(group: Group) -> None:
    for folder in group.work.pass_parts(group.name).glob("*"):
        publish_files(folder, group.work.folder)
    group.work.forget_checkpoints()


def _render(group: Group, request: GroupRequest, wanted: range) -> bool:
    """Render the requested files of a group; False if passes are still missing at the end."""
    passes = group.open(request)
    for folder, difference in passes.parts.others().items():
        say(f"{folder}: made with {difference}; left alone")
    if group.work.params.executor == "ray":
        # Imported only here: Ray is optional, and slow to import.
        from stages.references.cluster import render_on_cluster

        render_on_cluster(passes, request, wanted)
    else:
        passes.render(wanted)
    second = group.name == "second_reference"
    finished = passes.finish(snapshot_passes(passes.passes) if second else ())
    if finished is None:
        return False
    sums, snapshots = finished
    _write_files(group, request, passes, sums, snapshots)
    return True


def _write_files(
    group: Group,
    request: GroupRequest,
    passes: GroupPasses,
    sums: PassSums,
    snapshots: dict[str, dict[str, np.ndarray]],
) -> None:
    """Write the requested files of a group, all or none, and remove the parts.

    ``snapshots``: images by view and layer, for the second reference.
    """
    work, renderer = group.work, passes.renderer
    passes.costs.share(group.name, sorted({*renderer.sensors, *renderer.points}))

    def write(folder: Path) -> None:
        for view in group.views:
            if view.name not in request.views:
                continue
            if group.name == "second_reference":
                layers = snapshots[view.name]
            else:
                layers = renderer.view(view.name, sums, work.film_size).layers()
            for name, image in layers.items():
                if image.ndim == 3:
                    check_finite(image, f"{work.scene}, view {view.name}, {name}")
            facts = group.view_record(view) | _noise(work, sums, view.name)
            write_exr(folder / group.file(view.name).relative_to(work.folder), layers, facts)
        if SURFACES in renderer.points:
            points = renderer.points[SURFACES]
            tensors = {
                "position": to_numpy(points.p),
                "normal": to_numpy(points.n),
                "irradiance": renderer.mean_irradiance(SURFACES, sums),
                "direct": renderer.mean_direct(SURFACES, sums),
            }
            path = folder / work.surfaces.relative_to(work.folder)
            write_tensors(path, "surfaces", tensors, group.surface_record())

    prepare_files(passes.parts.folder, write)
    publish_files(passes.parts.folder, work.folder)
    work.forget_checkpoints()


def _noise(work: Workspace, sums: PassSums, view: str) -> dict[str, Any]:
    """The remaining noise of a view's image, for its file's record."""
    if view not in sums.views:
        return {}
    tally = sums.views[view]
    error, mean = tally.standard_error(sums.passes), tally.mean(sums.passes)
    return {
        "passes_done": sums.passes,
        "standard_error": float(np.sqrt(np.mean(error**2)) / max(np.mean(mean), 1e-30)),
        "expected_psnr": tally.expected_psnr(sums.passes, work.views.exposure),
    }


def _collect_targets(group: Group) -> None:
    """Write the supervised points of all training views and surfaces into one file."""
    parts = []
    for number, view in enumerate(group.views):
        layers, _ = read_exr(group.file(view.name))
        parts.append(targets_of_view(layers, number))
    if group.surface_points > 0:
        tensors, _ = read_tensors(group.work.surfaces, "surfaces")
        require_finite(group.work.surfaces, tensors)
        parts.append(targets_of_surfaces(tensors))
    save(join(parts), group.work.targets, group.work.scene)

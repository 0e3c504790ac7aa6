"""Passes on many machines: a task of a Ray cluster renders a range of passes.

A pass depends on its index alone, and sums over ranges add up exactly. A cluster therefore gives
the same bits as one machine, even if a task is repeated. A task carries all the data that it needs;
a worker needs only the same version of this package.
"""

from __future__ import annotations

import atexit
import io
import os
import shutil
import tempfile
import zipfile
from contextlib import chdir
from functools import cache
from pathlib import Path

import numpy as np

from gpf.core.cluster import ClusterChoice, cores_of_smallest_machine, task_result, wait_for_tasks
from gpf.core.errors import UserError
from gpf.core.progress import progress_bar
from stages.common.workspace import Workspace
from stages.references.group_passes import GroupPasses
from stages.references.groups import Group, GroupRequest, Job


def render_on_cluster(passes: GroupPasses, request: GroupRequest, wanted: range) -> None:
    """Render the missing passes of a range (0-based), and save every part as it arrives."""
    todo = _tasks(passes, wanted)
    if not todo:
        return
    ray, settings = _cluster(passes.work).connect(), passes.work.params.cluster
    project = ray.put(pack(passes.work))
    cores = settings.threads or cores_of_smallest_machine(ray)
    task = ray.remote(num_cpus=cores, max_retries=settings.retries)(render_part)
    facts = passes.work.scene, request, passes.parts.digest, settings.threads
    running = {task.remote(project, *facts, part.start, part.stop): part for part in todo}
    done = len(wanted) - sum(map(len, todo))
    try:
        with progress_bar(f"{passes.title}, Ray", len(wanted)) as bar:
            bar(done)
            total = passes.merge()
            # Tasks end in any order; the total grows by parts that follow without a gap.
            waiting = {part.start: part for part in passes.parts.done()}
            while running and not passes.is_good_enough(total):
                for reference in wait_for_tasks(ray, running):
                    part = running.pop(reference)
                    what = f"a task of passes {part.start}:{part.stop}"
                    tensors, costs = task_result(ray, reference, what)
                    sums = passes.renderer.empty_sums()
                    sums.add_tensors(tensors, len(part))
                    passes.save(part, sums, costs)
                    waiting[part.start] = part
                    while total.passes in waiting and not passes.is_good_enough(total):
                        passes.parts.add_to(total, waiting[total.passes])
                    done += len(part)
                    bar(done)
                    passes.update_previews(bar, total)
    finally:
        for reference in running:
            ray.cancel(reference, force=True)
        passes.costs.parts.pop(passes.group, None)


def render_part(
    project: bytes,
    scene: str,
    request: GroupRequest,
    digest: str,
    threads: int,
    first: int,
    last: int,
) -> tuple[dict[str, np.ndarray], dict[str, float]]:
    """On a worker: sums over passes ``first`` + 1 to ``last`` as tensors, and their cost."""
    import drjit as dr

    # At least two: with one, Mitsuba hangs when it reads an EXR file.
    dr.set_thread_count(max(2, threads or os.cpu_count() or 1))
    with chdir(_unpack(project)):
        passes = _open(scene, request, digest)
        renderer, costs = passes.renderer, passes.costs
        costs.parts.pop(request.group, None)
        with costs.measure(request.group):
            sums = renderer.empty_sums()
            for t in range(first, last):
                renderer.run_pass(t + 1, sums)
        return sums.tensors(), costs.parts[request.group]


def pack(work: Workspace) -> bytes:
    """A zip archive of the files that a worker needs: parameters, scene and views."""
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w", zipfile.ZIP_DEFLATED, strict_timestamps=False) as archive:
        archive.write("params.yaml")
        # Only the existence of this file is checked.
        archive.writestr(zipfile.ZipInfo(f"scenes/{work.scene}/scene.xml"), "")
        archive.write(work.views_file, f"scenes/{work.scene}/views.yaml")
        archive.write(work.views_file)
        for path in sorted(work.scene_snapshot.rglob("*")):
            archive.write(path)
    return data.getvalue()


def _tasks(passes: GroupPasses, wanted: range) -> list[range]:
    """The missing passes as ranges, one for each task."""
    size = passes.work.params.cluster.passes_per_task
    cuts = sorted({*passes.cuts(), *range(0, passes.passes, size)})
    return passes.parts.missing(wanted, cuts)


def _cluster(work: Workspace) -> ClusterChoice:
    """The cluster of params.yaml."""
    settings = work.params.cluster
    return ClusterChoice(
        "params.yaml: executor",
        settings.address,
        "params.yaml: cluster.address",
        settings.workers * max(settings.threads, 1),
    )


@cache
def _unpack(project: bytes) -> Path:
    """A folder with the contents of the archive, made once per process."""
    folder = Path(tempfile.mkdtemp(prefix="gpf-worker-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    with zipfile.ZipFile(io.BytesIO(project)) as archive:
        archive.extractall(folder)
    return folder


@cache
def _open(scene: str, request: GroupRequest, digest: str) -> GroupPasses:
    """The passes of a group, loaded once per process."""
    passes = Group(Job.open(Workspace.open(scene)), request.group).open(request)
    if passes.parts.digest != digest:
        raise UserError(
            "a worker of the cluster",
            "has a different version of this package or of Mitsuba, or a different kind of device",
            "Install the same versions on all machines, and set runtime.variant.",
        )
    return passes

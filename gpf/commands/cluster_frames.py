"""Fields of frames on many machines: each task of a Ray cluster fits a stretch of frames.

The first frame is fitted before all others, which begin with it, directly or through the frames
before them. So fields depend on the number of machines, but seams hardly show where one
machine's frames end and another's begin.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from gpf.commands.frame_fit import FrameFit, Stretch, cut_chunks, find_stretches
from gpf.commands.scenes import field_of_frame
from gpf.commands.workers import (
    SentScenes,
    begin_work,
    kept_warnings,
    pack_field,
    unpack_field,
)
from gpf.core.cluster import ClusterChoice, cores_of_smallest_machine, run_tasks, tasks_at_once
from gpf.core.files import write_atomically
from gpf.core.progress import say
from gpf.fitting.frames import Frame
from gpf.scene.frames import SceneFrame
from gpf.scene.load import load_frame


def fit_on_cluster(
    choice: ClusterChoice,
    fit: FrameFit,
    frames: Sequence[SceneFrame],
    missing: Sequence[int],
    folder: Path,
) -> Iterator[SceneFrame]:
    """Fit frames, write their fields as they arrive, and yield each frame that has its field.

    Parameters
    ----------
    frames: all frames.
    missing: the numbers of those without fields.

    Raises
    ------
    UserError: there is no such cluster, or a worker raised one.
    """
    ray = choice.connect()
    cores = cores_of_smallest_machine(ray)
    task = ray.remote(num_cpus=cores, num_returns="streaming")(fit_stretch)

    def submitted(part: list[Stretch]) -> Iterator[tuple[Stretch, Any]]:
        for stretch in part:
            own, before = [*frames[stretch.start : stretch.stop]], None
            if stretch.before is not None:
                first = frames[stretch.before]
                own, before = [first, *own], field_of_frame(folder, first).read_bytes()
            yield stretch, task.remote(fit, SentScenes.pack(own), before)

    chunks = cut_chunks(len(frames), tasks_at_once(ray, cores))
    stretches = find_stretches(missing, chunks)
    by_name = {frame.name: frame for frame in frames}
    for part in ([s for s in stretches if not s.start], [s for s in stretches if s.start]):
        for _, (name, data, warnings) in run_tasks(ray, cores, submitted(part)):
            frame = by_name[name]
            for line in warnings:
                say(f"{name}: {line}")
            write_atomically(field_of_frame(folder, frame), partial(_write, data))
            yield frame


def _write(data: bytes, file: Path) -> None:
    file.write_bytes(data)


def fit_stretch(
    fit: FrameFit, scenes: SentScenes, before: bytes | None
) -> Iterator[tuple[str, bytes, list[str]]]:
    """On a worker: the names of frames, the contents of their fields' files, and warnings.

    Parameters
    ----------
    before: that of the first scene, which the others begin with; None to fit the first as well.
    """
    begin_work()
    with scenes.unpacked() as frames, kept_warnings() as warnings:
        if before is None:
            fields = fit.fields(frames, None)
        else:
            first, *rest = frames
            fields = fit.fields(rest, Frame(load_frame(first), unpack_field(before)))
        for frame, field in fields:
            yield frame.name, pack_field(field), [*warnings]
            warnings.clear()

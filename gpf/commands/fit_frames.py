"""`gpf fit --frames`: a field for each frame of an animation."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from gpf.commands.cameras import file_beside
from gpf.commands.cluster_frames import fit_on_cluster
from gpf.commands.frame_fit import FrameFit, find_stretches
from gpf.commands.scenes import changed_since, field_of_frame, find_frames
from gpf.core.cluster import ClusterChoice
from gpf.core.errors import UserError
from gpf.core.locks import sole_run
from gpf.core.partial import remove_leftovers
from gpf.core.progress import progress_bar, say
from gpf.core.runtime import choose_variant
from gpf.field.io import load_field, read_field, save_field
from gpf.fitting.frames import Frame
from gpf.importing.placement import ROWS
from gpf.scene.frames import SceneFrame, choose_frames
from gpf.scene.light_groups import LightGroups
from gpf.scene.load import load_frame
from gpf.scene.transforms import read_cameras


def fit_scene_frames(
    animation: Path,
    wanted: str,
    folder: Path,
    seconds: float | None,
    passes: int | None,
    views: Path | None,
    seed: int,
    groups: str = "",
    overwrite: bool = False,
    cluster: ClusterChoice | None = None,
) -> None:
    """Fit a field to each frame of an animation, and write it to ``FRAME.safetensors``.

    Interrupted, the same command fits the frames that have no field. Each begins with the Gaussians
    of the frame before it (:mod:`gpf.commands.frame_fit`), or, if that has none either, follows it.

    Parameters
    ----------
    animation: as for :func:`gpf.commands.scenes.find_frames`.
    wanted: as for :func:`gpf.scene.frames.choose_frames`.
    folder: for the fields.
    seconds, passes, seed: as for :func:`gpf.fitting.frames.fit_frames`.
    views: a ``views.yaml`` or ``transforms.json`` with the views that the fields are for; by
        default the ``views.yaml`` beside the scenes; without one, cameras are placed around the own
        ones of the frames.
    groups: as for :meth:`LightGroups.parse`, in the first frame.
    overwrite: whether to replace fields of other scenes.
    cluster: the machines that fit the frames; None for this one.

    Raises
    ------
    UserError: as these; or the folder has fields of other scenes.
    """
    every = find_frames(animation, wanted)
    frames = every[choose_frames(wanted, len(every), str(animation))]
    choose_variant("auto")
    beside = file_beside(frames[0].file, views)
    say("cameras: placed around the scenes' own" if beside is None else f"cameras: from {beside}")
    cameras = None if beside is None else read_cameras(beside)
    fit = FrameFit(
        seconds,
        passes,
        seed,
        LightGroups.parse(groups, load_frame(frames[0])) if groups else None,
        None if cameras is None else (*cameras.train, *cameras.novel),
        (ROWS, ROWS) if cameras is None else cameras.size(ROWS),
    )
    with sole_run(folder, inside=True), progress_bar(f"{folder.name}: frames", len(frames)) as bar:
        remove_leftovers(folder)
        missing = [k for k, frame in enumerate(frames) if not _is_done(folder, frame, overwrite)]
        done = len(frames) - len(missing)
        if done:
            say(f"{folder}: {done} of {len(frames)} frames are done")
        bar(done)
        todo = fit, frames, missing, folder
        for _ in _fit_here(*todo) if cluster is None else fit_on_cluster(cluster, *todo):
            done += 1
            bar(done)
    say(f"{folder}: {len(frames)} fields")


def refuse_with_frames(options: Mapping[str, object]) -> None:
    """Raise a :class:`UserError` if one of these options, which frames do not have, is given."""
    for option, value in options.items():
        if value is not None:
            todo = "Leave one of them out; a fit of frames that was interrupted goes on."
            raise UserError(f"--frames and {option}", "are mutually exclusive", todo)


def _is_done(folder: Path, frame: SceneFrame, overwrite: bool) -> bool:
    """Whether a frame has its field."""
    file = field_of_frame(folder, frame)
    if not file.exists():
        return False
    parts = changed_since(load_frame(frame), read_field(file))
    if parts and not overwrite:
        what = f"was fitted to another scene than {frame.file}: different {parts}"
        raise UserError(str(file), what, "Add --overwrite, or give another folder.")
    return not parts


def _fit_here(
    fit: FrameFit, frames: Sequence[SceneFrame], missing: Sequence[int], folder: Path
) -> Iterator[SceneFrame]:
    """Fit frames, write their fields, and yield each frame that has its field; parameters as for
    :func:`fit_on_cluster`."""
    for stretch in find_stretches(missing):
        before = None
        if stretch.before is not None:
            last = frames[stretch.before]
            before = Frame(load_frame(last), load_field(field_of_frame(folder, last)))
        fields = fit.fields(frames[stretch.start : stretch.stop], before)
        del before  # so that its scene is free as soon as the next one has its field
        for frame, field in fields:
            save_field(field, field_of_frame(folder, frame))
            yield frame

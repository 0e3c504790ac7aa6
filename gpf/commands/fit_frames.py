"""`gpf fit --frames`: a field for each frame of an animation."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from gpf.commands.cameras import file_beside
from gpf.commands.cluster_frames import fit_on_cluster
from gpf.commands.fit_options import FitOptions
from gpf.commands.frame_fit import FrameFit, find_stretches
from gpf.commands.scenes import changed_since, field_of_frame, find_frames
from gpf.core.cluster import ClusterChoice
from gpf.core.errors import UserError
from gpf.core.locks import sole_run
from gpf.core.partial import remove_leftovers
from gpf.core.progress import progress_bar, say
from gpf.core.runtime import choose_variant
from gpf.field.io import StoredField, load_field, read_field, save_field
from gpf.fitting.frames import Frame
from gpf.placement.cameras import ROWS
from gpf.scene.fingerprint import SAME_FRAME
from gpf.scene.frames import SceneFrame, choose_frames
from gpf.scene.light_groups import LightGroups
from gpf.scene.load import load_frame
from gpf.scene.transforms import read_cameras


def fit_scene_frames(
    animation: Path,
    wanted: str,
    folder: Path,
    options: FitOptions,
    overwrite: bool = False,
    cluster: ClusterChoice | None = None,
) -> None:
    """Fit a field to each frame of an animation, and write it to ``FRAME.safetensors``.

    Interrupted, the same command fits the frames that have no field. Each begins with the Gaussians
    of the frame before it (:mod:`gpf.commands.frame_fit`), or, if that has none either, follows it.
    Frames that have one keep it, also where the frame before gets another.

    Parameters
    ----------
    animation: as for :func:`gpf.commands.scenes.find_frames`.
    wanted: as for :func:`gpf.scene.frames.choose_frames`.
    folder: for the fields.
    options: without a target PSNR. Groups are those of the animation's first frame; the views
        beside the scenes are the default.
    overwrite: whether to replace fields of other scenes, or that were fitted with other settings;
        the others stay.
    cluster: the machines that fit the frames; None for this one.

    Raises
    ------
    UserError: as these and :func:`gpf.fitting.frames.fit_frames`; the groups are wrong; or the
        folder has such fields.
    """
    every = find_frames(animation, wanted)
    chosen = choose_frames(wanted, len(every), str(animation))
    frames = every[chosen]
    choose_variant("auto")
    first = next(frame for frame in every if frame.file.exists())
    beside = file_beside(first.file, file_beside(animation, options.views))
    say("cameras: placed around the scenes' own" if beside is None else f"cameras: from {beside}")
    cameras = None if beside is None else read_cameras(beside)
    fit = FrameFit(
        options.seconds,
        options.passes,
        options.seed,
        LightGroups.parse(options.groups, load_frame(first)) if options.groups else None,
        None if cameras is None else (*cameras.train, *cameras.novel),
        (ROWS, ROWS) if cameras is None else cameras.size(ROWS),
    )
    with sole_run(folder, inside=True), progress_bar(f"{folder.name}: frames", len(frames)) as bar:
        remove_leftovers(folder)
        done = [_is_done(fit, folder, frame, overwrite) for frame in frames]
        ready = sum(done)
        if ready:
            say(f"{folder}: {ready} of {len(frames)} frames are done")
        bar(ready)
        if chosen.start > 0 and not done[0]:
            last = every[chosen.start - 1]
            if _has_field(folder, last):  # the first one goes on from it
                frames, done = [last, *frames], [True, *done]
            else:
                say(f"{frames[0].name} begins anew: {folder} has no current field of {last.name}")
        todo = fit, frames, [k for k, is_done in enumerate(done) if not is_done], folder
        for _ in _fit_here(*todo) if cluster is None else fit_on_cluster(cluster, *todo):
            ready += 1
            bar(ready)
    say(f"{folder}: {ready} fields")


def refuse_with_frames(options: Mapping[str, object]) -> None:
    """Raise a :class:`UserError` if one of these options, which frames do not have, is given."""
    for option, value in options.items():
        if value is not None:
            todo = "Leave one of them out; a fit of frames that was interrupted goes on."
            raise UserError(f"--frames and {option}", "are mutually exclusive", todo)


def _is_done(fit: FrameFit, folder: Path, frame: SceneFrame, overwrite: bool) -> bool:
    """Whether a frame has its field."""
    file = field_of_frame(folder, frame)
    if not file.exists():
        return False
    other = _other(fit, frame, read_field(file))
    if other and not overwrite:
        raise UserError(
            str(file), f"was fitted {other}", "Add --overwrite, or give another folder."
        )
    return not other


def _has_field(folder: Path, frame: SceneFrame) -> bool:
    """Whether a frame has a field, fitted with any settings."""
    file = field_of_frame(folder, frame)
    return file.exists() and not changed_since(load_frame(frame), read_field(file), SAME_FRAME)


def _other(fit: FrameFit, frame: SceneFrame, field: StoredField) -> str:
    """What a field was fitted to or with, in words, if that is not what is asked for."""
    if parts := changed_since(load_frame(frame), field, SAME_FRAME):
        return f"to another scene than {frame.file}: different {parts}"
    known = field.record.get("asked", {})
    other = [key for key, value in fit.asked().items() if known.get(key, value) != value]
    return f"with other settings: {', '.join(other)}" if other else ""


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

"""`gpf fit --frames`: a field for each frame of an animation."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import mitsuba as mi

from gpf.commands.cameras import file_beside
from gpf.commands.scenes import changed_since, find_frames
from gpf.core.errors import UserError
from gpf.core.locks import sole_run
from gpf.core.partial import remove_leftovers
from gpf.core.progress import progress_bar, say
from gpf.core.runtime import choose_variant
from gpf.field.io import load_field, save_field
from gpf.fitting.frames import Frame, fit_frames
from gpf.importing.placement import ROWS
from gpf.scene.frames import SceneFrame, choose_frames
from gpf.scene.light_groups import LightGroups
from gpf.scene.load import load_scene_file
from gpf.scene.transforms import read_sensors
from gpf.scene.untraceable import telling_untraceable


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
) -> None:
    """Fit a field to each frame of an animation, and write it to ``FRAME.safetensors``.

    Interrupted, the same command goes on after the last field.

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

    Raises
    ------
    UserError: as these; or the folder has fields of other scenes.
    """
    every = find_frames(animation, wanted)
    frames = every[choose_frames(wanted, len(every), str(animation))]
    choose_variant("auto")
    beside = file_beside(frames[0].file, views)
    sensors = None if beside is None else read_sensors(beside, ROWS)[0]
    say("cameras: placed around the scenes' own" if beside is None else f"cameras: from {beside}")
    with (
        sole_run(folder, inside=True),
        telling_untraceable(str(animation)),
        progress_bar(f"{folder.name}: frames", len(frames)) as bar,
    ):
        remove_leftovers(folder)
        done, before = _fields_so_far(folder, frames, overwrite)
        if done:
            say(f"{folder}: continuing after {done} of {len(frames)} frames")
        bar(done)
        rest = frames[done:]
        fields = fit_frames(
            map(_load, rest),
            sensors,
            seconds=seconds,
            passes=passes,
            seed=seed,
            groups=LightGroups.parse(groups, _load(frames[0])) if groups else None,
            before=before,
        )
        for frame, field in zip(rest, fields, strict=True):
            save_field(field, _file(folder, frame))
            done += 1
            bar(done)
    say(f"{folder}: {len(frames)} fields")


def _fields_so_far(
    folder: Path, frames: Sequence[SceneFrame], overwrite: bool
) -> tuple[int, Frame | None]:
    """How many frames in a row have their fields, and the last of them."""
    last = None
    for number, frame in enumerate(frames):
        file = _file(folder, frame)
        if not file.exists():
            return number, last
        scene, field = _load(frame), load_field(file)
        if parts := changed_since(scene, field):
            if overwrite:
                return number, last
            what = f"was fitted to another scene than {frame.file}: different {parts}"
            raise UserError(str(file), what, "Add --overwrite, or give another folder.")
        last = Frame(scene, field)
    return len(frames), last


def _file(folder: Path, frame: SceneFrame) -> Path:
    return folder / f"{frame.name}.safetensors"


def _load(frame: SceneFrame) -> mi.Scene:
    return load_scene_file(frame.file, parameters=frame.parameters)

"""What `gpf render` is asked for: scenes with their fields, and the views of each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import mitsuba as mi

from gpf.blender.conversion import is_foreign
from gpf.commands.cameras import (
    CameraChoice,
    Cameras,
    camera_of_frame,
    choose_cameras,
    file_beside,
)
from gpf.commands.scenes import (
    FIELDS,
    field_of_frame,
    find_field,
    find_frames,
    find_scene,
    require_same_scene,
)
from gpf.core.errors import UserError
from gpf.field.field import GaussianPhotonField
from gpf.field.io import load_field
from gpf.scene.fingerprint import SAME, SAME_FRAME
from gpf.scene.frames import choose_frames, is_animation
from gpf.scene.load import load_scene_file


@dataclass(frozen=True)
class FramePlace:
    """A frame's number in its animation, from 0, the name of its pictures, and its time from 0 to
    1."""

    number: int
    name: str
    time: float


@dataclass(frozen=True)
class Shot:
    """A scene with its field, and the views of it.

    Attributes
    ----------
    choice: the views.
    frame: its place in an animation, or None.
    parameters: of the scene file.
    """

    scene_file: Path
    field_file: Path
    choice: CameraChoice
    frame: FramePlace | None = None
    parameters: Mapping[str, str] = field(default_factory=dict)

    def open(self, changed_scene: bool) -> tuple[mi.Scene, GaussianPhotonField, Cameras]:
        """The scene, its field and its views.

        Parameters
        ----------
        changed_scene: whether to accept a field of another scene.

        Raises
        ------
        UserError: a file or a view is wrong, or the field is for another scene.
        """
        found = load_field(self.field_file)
        scene = load_scene_file(self.scene_file, parameters=self.parameters)
        tolerance = SAME if self.frame is None else SAME_FRAME
        require_same_scene(scene, self.scene_file, found, self.field_file, changed_scene, tolerance)
        where = scene, self.scene_file, self.choice
        if self.frame is None:
            return scene, found, choose_cameras(*where)
        return scene, found, camera_of_frame(*where, self.frame.name, self.frame.number)


def find_shots(
    scene_name: str, field_name: str | None, choice: CameraChoice
) -> tuple[list[Shot], Path]:
    """The shots that are asked for, and the folder for their pictures, if none is given.

    Parameters
    ----------
    scene_name: as for :func:`gpf.commands.scenes.find_scene`, or, with frames asked for, an
        animation (:func:`gpf.commands.scenes.find_frames`). In a file that Blender reads, these are
        frames of the animation if there is a folder with their fields, else of the camera path.
    field_name: as for :func:`gpf.commands.scenes.find_field`; of an animation, the folder with a
        field for each frame, by default :data:`gpf.commands.scenes.FIELDS`.
    """
    scene, fields = Path(scene_name), Path(field_name or FIELDS)
    has_fields = fields.is_dir() and (field_name is not None or is_foreign(scene))
    if choice.frames and (has_fields or is_animation(scene)):
        return _frames(scene, fields, choice), Path("pictures")
    scene_file, trained = find_scene(scene_name)
    if trained and choice.file is None and (trained / "views.yaml").exists():
        choice = replace(choice, file=trained / "views.yaml")
    return [Shot(scene_file, find_field(field_name, trained), choice)], (
        trained or Path()
    ) / "pictures"


def _frames(animation: Path, fields: Path, choice: CameraChoice) -> list[Shot]:
    """A shot for each frame of an animation."""
    if not fields.is_dir():
        todo = f"Run `gpf fit {animation} --frames all -o {fields}`, or give --field FOLDER."
        raise UserError(str(fields), "is not a folder with the fields of the frames", todo)
    if choice.orbit:
        raise UserError("--frames and --orbit", "are mutually exclusive", "Give one of them.")
    if len(choice.names) > 1:
        what = f"shows one view, but --view is given {len(choice.names)} times"
        raise UserError("--frames", what, "Render one view after the other.")
    choice = replace(choice, file=file_beside(animation, choice.file))
    assert choice.frames is not None
    every = find_frames(animation, choice.frames)
    numbers = range(len(every))[choose_frames(choice.frames, len(every), str(animation))]
    found = []
    for number in numbers:
        frame = every[number]
        place = FramePlace(number, frame.name, number / max(len(every) - 1, 1))
        field_file = field_of_frame(fields, frame)
        found.append(Shot(frame.file, field_file, choice, place, frame.parameters))
    return found

"""The scenes and fields that commands are given, and whether they belong together."""

from __future__ import annotations

from pathlib import Path

import mitsuba as mi

from gpf.blender.conversion import is_foreign
from gpf.commands.convert import frames_of, scene_of
from gpf.core.errors import UserError
from gpf.core.yaml import suggest
from gpf.field.field import GaussianPhotonField
from gpf.field.io import StoredField
from gpf.importing.sources import find_scene_file
from gpf.scene.fingerprint import SAME, changed_parts, fingerprint
from gpf.scene.frames import SceneFrame, scene_frames

RESULTS = Path("results")
"""Where the pipeline writes its results, in one folder per scene."""

FIELDS = Path("fields")
"""Where the fields of an animation are, if no folder is given."""


def field_of_frame(folder: Path, frame: SceneFrame) -> Path:
    """The file of a frame's field in the folder of an animation's fields."""
    return folder / f"{frame.name}.safetensors"


def find_scene(name: str) -> tuple[Path, Path | None]:
    """The file of a scene and, if it was given by name, the folder of its results.

    Parameters
    ----------
    name: a scene file, a file that Blender reads, a folder with a scene file, or the name of a
        scene of the pipeline.

    Raises
    ------
    UserError: the folder has no scene file or several, there is no scene with that name, or
        Blender cannot read the file.
    """
    path = Path(name)
    if is_foreign(path):
        return scene_of(path), None
    if path.is_dir():
        return find_scene_file(path, path), None
    if not _is_name(path):
        return path, None
    return _result(name, "scene/scene.xml", "scene"), RESULTS / name


def title_of(name: str) -> str:
    """What a scene is called that is given as for :func:`find_scene`: its file, without the suffix;
    the folder, if the file is ``scene.xml``."""
    path = Path(name).resolve()
    stem = path.name if path.is_dir() else path.stem
    return path.parent.name if stem == "scene" and path.suffix else stem


def find_frames(animation: Path, wanted: str) -> list[SceneFrame]:
    """All frames of an animation, in order.

    Parameters
    ----------
    animation: as for :func:`gpf.scene.frames.scene_frames`, or a file that Blender reads.
    wanted: as for :func:`gpf.scene.frames.choose_frames`; frames that are not may have no file yet.

    Raises
    ------
    UserError: there are no such frames, or Blender cannot read the file.
    """
    return frames_of(animation, wanted) if is_foreign(animation) else scene_frames(animation)


def find_field(name: str) -> Path:
    """The file of a field, given by its path or by the name of a scene that the pipeline trained.

    Raises
    ------
    UserError: there is no such file.
    """
    path = Path(name)
    if not _is_name(path):
        if not path.is_file():
            raise UserError(name, "does not exist", "Check the path.")
        return path
    return _result(name, "field.safetensors", "train")


def _is_name(path: Path) -> bool:
    return not (path.suffix or len(path.parts) > 1 or path.is_file())


def _result(scene: str, file: str, stage: str) -> Path:
    """A file that a stage of the pipeline made for a scene."""
    found = RESULTS / scene / file
    if found.is_file():
        return found
    known = [path.name for path in sorted(RESULTS.glob("*")) if (path / file).is_file()]
    raise UserError(
        scene,
        f"is neither a file nor a scene with {found}",
        suggest(scene, known, "There are")
        if known
        else f"Run `gpf stage {stage} --scene {scene}`.",
    )


def changed_since(
    scene: mi.Scene, field: GaussianPhotonField | StoredField, tolerance: float = SAME
) -> str:
    """The parts of a scene that have changed since a field was fitted to it, in words; empty if
    none has, or if the field does not record its scene."""
    known = field.record.get("fingerprint")
    changed = changed_parts(known, fingerprint(scene), tolerance) if known else []
    return " and ".join(", ".join(changed).rsplit(", ", 1))


def require_same_scene(
    scene: mi.Scene,
    scene_file: Path,
    field: GaussianPhotonField,
    field_file: Path,
    changed_scene: bool = False,
    tolerance: float = SAME,
) -> None:
    """Raise a :class:`UserError` if a field was fitted to another scene, or to this one before it
    was changed; fields that do not record their scene are accepted.

    The plugin does not check again: from now on, lamps may be dimmed.

    Parameters
    ----------
    changed_scene: whether to accept a field of another scene.
    """
    parts = "" if changed_scene else changed_since(scene, field, tolerance)
    field.record.pop("fingerprint", None)
    if parts:
        raise UserError(
            str(field_file),
            f"was fitted to another scene, or before {scene_file} was changed: different {parts}",
            "Run `gpf fit` again, or add --changed-scene to see the light of the other scene.",
        )

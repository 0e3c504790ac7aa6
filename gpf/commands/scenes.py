"""The scenes and fields that commands are given, and whether they belong together."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import mitsuba as mi

from gpf.blender.conversion import SUFFIXES, is_foreign
from gpf.commands.convert import frames_of, scene_of
from gpf.core.checkout import CHECKOUT
from gpf.core.errors import UserError
from gpf.core.yaml import suggest
from gpf.field.field import GaussianPhotonField
from gpf.field.io import StoredField, read_field
from gpf.scene.fingerprint import SAME, changed_parts, fingerprint
from gpf.scene.frames import SceneFrame, is_animation, scene_frames
from gpf.scene.views import read_views

RESULTS = Path("results")
"""Where the pipeline writes its results, in one folder per scene."""

FIELD = Path("field.safetensors")
"""A field, if no file is given."""

FIELDS = Path("fields")
"""Where the fields of an animation are, if no folder is given."""

DEPTH = 3
"""Levels of folders searched for a scene file."""


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
    UserError: there is no such file or no scene with that name, the file is no scene, the folder
        has no scene file or several, or Blender cannot read the file.
    """
    path = Path(name)
    if path.is_dir():
        return find_scene_file(path, path), None
    if _is_name(path):
        return _result(name, "scene/scene.xml", "scene"), RESULTS / name
    _require_file(path, "a scene", (".xml", *SUFFIXES))
    return scene_of(path) if is_foreign(path) else path, None


def find_scene_file(folder: Path, named: Path) -> Path:
    """The scene file of a folder: ``scene.xml``, or the only XML file on its level.

    The folder itself is searched first, then the folders in it, level by level. ``named`` is the
    path that the user gave, for messages.

    Raises
    ------
    UserError: there is no XML file, or several, none of them ``scene.xml``.
    """
    for level in range(DEPTH):
        found = sorted(
            file
            for file in folder.glob("*/" * level + "*.[xX][mM][lL]")
            if file.is_file() and not any(_is_hidden(p) for p in file.relative_to(folder).parts)
        )
        chosen = [file for file in found if file.name == "scene.xml"] or found
        if len(chosen) == 1:
            return chosen[0]
        if chosen:
            names = ", ".join(file.relative_to(folder).as_posix() for file in chosen)
            how = "Give" if folder == named else "Unpack it and give"
            todo = f"{how} the path of one of them."
            if is_animation(named):
                todo += " If they are frames, `gpf fit` and `gpf render` take them by --frames all."
            raise UserError(str(named), f"has several XML files ({names})", todo)
    raise UserError(
        str(named),
        "has no XML file",
        "Give a folder with a Mitsuba scene, its XML file, or a zip archive with an XML file.",
    )


def _is_hidden(part: str) -> bool:
    return part.startswith(".") or part == "__MACOSX"


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


def find_field(name: str | None, trained: Path | None = None) -> Path:
    """The file of a field.

    Parameters
    ----------
    name: its path, or the name of a scene that the pipeline trained.
    trained: the scene's results, as from :func:`find_scene`, which have the default; without them,
        it is :data:`FIELD`.

    Raises
    ------
    UserError: there is no such file, or it is no field.
    """
    if name is None and trained is None and not FIELD.exists():
        raise UserError(str(FIELD), "does not exist", "Run `gpf fit SCENE`, or name a field.")
    path = Path(name or (trained.name if trained else FIELD))
    if _is_name(path):
        return _result(str(path), FIELD.name, "train")
    _require_file(path, "a field", (FIELD.suffix,))
    return path


def read_given(file: Path) -> StoredField:
    """Read a field. Errors do not suggest deleting the file, which may be of another kind."""
    try:
        return read_field(file)
    except UserError as error:
        raise UserError(error.where, error.what, "Give the file of a field.") from error


def known_exposure(views: Path | None, field: GaussianPhotonField | StoredField) -> float | None:
    """The exposure of a ``views.yaml`` or of a field; None if neither has one."""
    known = None if views is None else read_views(views).given_exposure
    return known or field.record.get("exposure")


def _require_file(path: Path, kind: str, suffixes: Sequence[str]) -> None:
    """Raise a :class:`UserError` unless a file is there, with a name that ends like those of its
    kind, or without any ending."""
    if not path.exists():
        raise UserError(str(path), "does not exist", "Check the path.")
    if path.suffix.lower() not in ("", *suffixes):
        todo = f"Give a file whose name ends in {', '.join(suffixes)}."
        raise UserError(str(path), f"is not {kind}", todo)


def _is_name(path: Path) -> bool:
    return not (path.suffix or len(path.parts) > 1 or path.is_file())


def _result(scene: str, file: str, stage: str) -> Path:
    """A file that a stage of the pipeline made for a scene."""
    found = RESULTS / scene / file
    if found.is_file():
        return found
    known = [path.name for path in sorted(RESULTS.glob("*")) if (path / file).is_file()]
    if CHECKOUT is not None and Path("scenes", scene, "scene.xml").is_file():
        todo = f"Run `gpf stage {stage} --scene {scene}`."
    else:
        todo = suggest(scene, known, "There are") if known else "Check the path."
    raise UserError(scene, f"is neither a file nor a scene with {found}", todo)


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

"""Convert files that Blender reads into folders with a Mitsuba scene."""

from __future__ import annotations

import hashlib
import re
import shutil
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import platformdirs

from gpf.blender.process import PROGRAMS, read_with_blender
from gpf.blender.scene_dict import Translation, principal_point, translate_scene
from gpf.blender.textures import Textures
from gpf.core.errors import UserError
from gpf.core.files import read_json, write_json, write_text
from gpf.core.partial import grant_as_usual, partial_folder, remove_leftovers, replace_folder
from gpf.core.runtime import two_threads
from gpf.core.vectors import normalise
from gpf.scene.frames import SceneFrame, choose_frames
from gpf.scene.upright import upright
from gpf.scene.views import CameraPath, Keyframe, SceneViews, View, ViewSets, name_view
from gpf.scene.views_file import write_views

SUFFIXES = (*(".blend", ".glb", ".gltf", ".usd", ".usda", ".usdc", ".usdz", ".fbx", ".obj"),)
"""What Blender reads."""

RECORD = "converted.json"
"""What a converted scene was made from."""

RIGHT = ("exact", "baked")
"""What became of materials that look as in Blender."""


@dataclass(frozen=True)
class Converted:
    """A converted scene, or an animation.

    Attributes
    ----------
    folder: where it is.
    how: for each material, "exact", "baked", or what is approximated.
    notes: what is left out or approximated elsewhere, and what was baked more than once.
    numbers: of the frames that the file has, by Blender's count; empty if it was not converted as
        an animation.
    """

    folder: Path
    how: Mapping[str, str]
    notes: tuple[str, ...]
    numbers: tuple[int, ...] = ()

    @property
    def xml(self) -> Path:
        """The scene file, if it is no animation."""
        return self.folder / "scene.xml"

    def frames(self) -> list[SceneFrame]:
        """All frames that the file has; those that were not asked for have no scene file."""
        names = [f"frame_{number:04}" for number in self.numbers]
        return [SceneFrame(name, self.folder / f"{name}.xml") for name in names]

    def files(self) -> list[Path]:
        """The scene files."""
        return sorted(self.folder.glob("*.xml"))


def is_foreign(file: Path) -> bool:
    """Whether a file must be converted before Mitsuba can load it."""
    return file.suffix.lower() in SUFFIXES


def converted(file: Path, tell: Callable[[str], None], frames: str | None = None) -> Converted:
    """The scene of a file, or some of its frames, the one before them and the first one, in the
    user's cache, converted if the file is new or has changed.

    Parameters, errors: as for :func:`convert`.
    """
    require_file(file)
    program = _digest_of_program()
    folders = [_cached(file, wanted) for wanted in ((None,) if frames is None else ("all", frames))]
    for folder in folders:  # the whole animation has any part of it
        if (folder / RECORD).is_file():
            known = read_json(folder / RECORD)
            if known.get("program") == program and _stamps(known["files"]) == known["files"]:
                numbers = tuple(known["numbers"])
                return Converted(folder, known["how"], tuple(known["notes"]), numbers)
    return convert(file, folders[-1], tell, frames, earlier=True)


def _cached(file: Path, frames: str | None) -> Path:
    """The folder of a scene in the user's cache."""
    what = str(file.resolve()) + ("" if frames is None else f" {frames}")
    key = hashlib.sha256(what.encode()).hexdigest()[:12]
    return scenes_folder() / f"{file.stem}-{key}"


def scenes_folder() -> Path:
    """Where converted scenes are kept."""
    return platformdirs.user_cache_path("gpf") / "scenes"


def origin_of(scene_file: Path) -> Path:
    """The file that a scene in the user's cache was made from; any other scene file itself."""
    if scene_file.parent.parent != scenes_folder():
        return scene_file
    with suppress(UserError, KeyError):  # of an earlier version, or damaged
        return Path(read_json(scene_file.parent / RECORD, dict[str, Any])["file"])
    return scene_file


def convert(
    file: Path,
    folder: Path,
    tell: Callable[[str], None],
    frames: str | None = None,
    earlier: bool = False,
) -> Converted:
    """Write a folder with the scene of a file: ``scene.xml``, meshes and textures, ``views.yaml``
    if there are several cameras or one that moves, and a list of what became of each material.

    The folder appears when it is complete; one that exists is replaced.

    Parameters
    ----------
    frames: some frames of the file, as for :func:`gpf.scene.frames.choose_frames`. Instead of
        ``scene.xml`` and ``views.yaml``, each becomes a scene file with its own camera:
        ``frame_0001.xml`` and so on, by Blender's numbers. What is the same in several frames is
        written once.
    earlier: whether to write the first frame, too, and the one before those that are asked for: a
        fit goes on from them.

    Raises
    ------
    UserError: the file does not exist or is in an unknown format, it has no such frames, or Blender
        is missing or cannot read it.
    """
    require_file(file)
    folder.parent.mkdir(parents=True, exist_ok=True)
    remove_leftovers(folder.parent)
    with tempfile.TemporaryDirectory() as name, partial_folder(folder) as new:
        work = Path(name)
        asked = _one_earlier(frames) if frames is not None and earlier else frames
        read_with_blender(file, work, tell, asked)
        tell("writing the scene")
        names, numbers, repeated = {"scene": ""}, [], []
        if frames is not None:
            known = read_json(work / "frames.json")
            numbers, repeated = known["numbers"], known["notes"]
            chosen = choose_frames(frames, len(numbers), str(file))
            wanted = numbers[chosen]
            if earlier and chosen.start > 0:
                wanted = [*dict.fromkeys((numbers[0], numbers[chosen.start - 1])), *wanted]
            names = {f"frame_{number:04}": f"_{number:04}" for number in wanted}
        last, how, notes = _write_scenes(work, new, names)
        notes += repeated
        if frames is None:
            _write_views(last, new / "views.yaml")
        elif last["exposure"] != 1:
            notes.append(f"exposure left out: render with --exposure {last['exposure']:.3g}")
        if (work / "meshes").is_dir():
            shutil.move(work / "meshes", new / "meshes")
        write_text(new / "converted.md", describe(file.name, last["blender"], how, notes))
        source = str(file.resolve())
        record = {"file": source, "numbers": numbers, "how": how, "notes": notes}
        made_by = {"program": _digest_of_program(), "files": _stamps([source, *last["files"]])}
        write_json(new / RECORD, record | made_by)
        grant_as_usual(new)
        replace_folder(new, folder)
    return Converted(folder, how, tuple(notes), tuple(numbers))


def _one_earlier(frames: str) -> str:
    """``FIRST:LAST`` with one frame more; any other text as it is."""
    first, _, last = frames.partition(":")
    return f"{int(first) - 1}:{last}" if first.isdecimal() and int(first) else frames


def _write_scenes(
    work: Path, folder: Path, names: Mapping[str, str]
) -> tuple[dict[str, Any], dict[str, str], list[str]]:
    """Write the scene files of Blender's descriptions.

    Parameters
    ----------
    work: the folder with these.
    names: names without suffix, each with what ends the names of images that are new there.

    Returns
    -------
    last: the last description.
    how, notes: as in :class:`Converted`; of a material that is not exact in all frames, how it is
        in the first of the others.
    """
    textures, last = Textures(work, folder, {}), {}
    how: dict[str, str] = {}
    notes: list[str] = []
    for name, suffix in names.items():
        last = read_json(work / f"{name}.json")
        textures.images, textures.suffix = last["images"], suffix
        with two_threads():  # with one, Mitsuba never ends reading or writing an EXR file
            result = translate_scene(last, textures)
        _write_scene(result, folder / f"{name}.xml")
        how |= {m: text for m, text in result.how.items() if how.get(m) in (None, *RIGHT)}
        notes += result.notes
    return last, how, list(dict.fromkeys(notes))


def require_file(file: Path) -> None:
    """Raise a :class:`UserError` unless a file is there and Blender can read its format."""
    if not is_foreign(file):
        raise UserError(str(file), "is in an unknown format", f"Give one of {', '.join(SUFFIXES)}.")
    if not file.is_file():
        raise UserError(str(file), "does not exist", "Check the path.")


def describe(name: str, blender: str, how: Mapping[str, str], notes: Sequence[str]) -> str:
    """The list of materials, and of what is left out, as Markdown."""
    lines = [f"# {name}", "", f"Read by Blender {blender}.", ""]
    lines += ["| material | how |", "|---|---|"]
    lines += [f"| {material} | {how} |" for material, how in sorted(how.items())]
    if notes:
        lines += ["", "Remarks:", ""]
        lines += [f"- {note}" for note in notes]
    return "\n".join([*lines, ""])


def _write_scene(result: Translation, path: Path) -> None:
    config = mi.parser.ParserConfig(mi.variant())
    state = mi.parser.parse_dict(config, result.scene)
    text = mi.parser.write_string(state)
    # Mitsuba writes the names of parts, but reads only ids.
    named = re.sub(r'<(shape|sensor) type="(\w+)" name="(\w+)"', r'<\1 type="\2" id="\3"', text)
    write_text(path, named)


def _write_views(found: Mapping[str, Any], path: Path) -> None:
    """Write the cameras if one moves, or if pictures have an exposure of their own."""
    cameras = [c for c in found["cameras"] if c["type"] == "PERSP"]
    moving = next((c for c in cameras if "frames" in c), None)
    if not cameras or (moving is None and found["exposure"] == 1):
        return
    names: list[str] = []
    views = []
    for camera in cameras:
        names.append(name_view(camera["name"], names, "camera"))
        shift = principal_point(camera, found["size"])
        views.append(
            View(name=names[-1], fov_axis=camera["fov_axis"], shift=shift, **_pose(camera))
        )
    path_of = None
    if moving is not None:
        frames, shift = moving["frames"], principal_point(moving, found["size"])
        for frame in frames[:: max(len(frames) // 6, 1)]:
            names.append(name_view("moving", names, "camera"))
            axis = moving["fov_axis"]
            views.append(View(name=names[-1], fov_axis=axis, shift=shift, **_pose(frame)))
        keyframes = upright([Keyframe(shift=shift, **_pose(frame)) for frame in frames])
        path_of = CameraPath(keyframes=tuple(keyframes), frames=len(frames))
    scene = SceneViews(
        views=ViewSets(train=tuple(upright(views))),
        path=path_of,
        exposure=found["exposure"],
        aspect=found["size"][0] / found["size"][1],
        fov_axis=(moving or cameras[0])["fov_axis"],
    )
    write_views(path, scene, "Cameras of the converted scene.")


def _pose(camera: Mapping[str, Any]) -> dict[str, Any]:
    matrix = np.array(camera["matrix"])
    origin, backward, up = matrix[:3, 3], matrix[:3, 2], matrix[:3, 1]
    target = origin - normalise(backward)
    return {
        "origin": tuple(origin.tolist()),
        "target": tuple(target.tolist()),
        "up": tuple(normalise(up).tolist()),
        "fov": camera["fov"],
    }


def _digest_of_program() -> str:
    """A digest of the program that converts."""
    own = sorted([*PROGRAMS.glob("*.py"), *PROGRAMS.parent.glob("*.py")])
    return hashlib.sha256(b"".join(file.read_bytes() for file in own)).hexdigest()


def _stamps(files: Iterable[str]) -> dict[str, list[int]]:
    """Size and time of each file; nothing of files that are missing."""
    facts = {name: Path(name).stat() if Path(name).is_file() else None for name in files}
    return {name: [f.st_size, f.st_mtime_ns] if f else [] for name, f in facts.items()}

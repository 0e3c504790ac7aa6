"""Scenes that move: the scene file of each frame.

An animation is one of

- a folder with a scene file for each frame, ``frame_0001.xml`` and so on, or with a folder for
  each frame that contains a ``scene.xml``; frames are ordered by the last number in their names;
- a scene file with the parameter ``$frame`` in names of files, such as ``water_$frame.ply``: each
  value with which all of these files exist is a frame.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from gpf.core.errors import UserError
from gpf.scene.xml import read_scene_xml

PARAMETER = "frame"

_ANY = "\0"  # in no name of a file


@dataclass(frozen=True)
class SceneFrame:
    """A frame of an animation.

    Attributes
    ----------
    name: for the files that are written for it.
    file: its scene file.
    parameters: values of the file's parameters.
    """

    name: str
    file: Path
    parameters: Mapping[str, str] = field(default_factory=dict)


def scene_frames(scene: Path) -> list[SceneFrame]:
    """The frames of an animation, in order.

    Raises
    ------
    UserError: there is none, or two have the same number.
    """
    found = _in_folder(scene) if scene.is_dir() else _by_parameter(scene)
    numbers = [_number(frame.name) for frame in found]
    for number in numbers:
        if numbers.count(number) > 1:
            both = " and ".join(frame.name for frame in found if _number(frame.name) == number)
            raise UserError(
                str(scene), f"has the frame {number} twice: {both}", "Rename or remove one."
            )
    return sorted(found, key=lambda frame: _number(frame.name))


def is_animation(scene: Path) -> bool:
    """Whether this is a folder of scene files, or a scene file with :data:`PARAMETER`."""
    if scene.is_dir():
        return len(list(scene.glob("*.xml"))) > 1 or any(scene.glob("*/scene.xml"))
    if scene.suffix != ".xml" or not scene.is_file():
        return False
    return PARAMETER in read_scene_xml(scene, {PARAMETER: _ANY}).parameters


def choose_frames(wanted: str, count: int, what: str) -> slice:
    """Some frames: ``all``, or ``FIRST:LAST`` for FIRST to LAST-1, counted from 0.

    Parameters
    ----------
    count: the number of frames there are.
    what: what has these frames, for the message.

    Raises
    ------
    UserError: there are no such frames.
    """
    if wanted == "all":
        return slice(0, count)
    if found := re.fullmatch(r"(\d{0,9}):(\d{0,9})", wanted):
        first, last = int(found[1] or 0), int(found[2] or count)
        if first < last <= count:
            return slice(first, last)
    raise UserError(
        f"--frames {wanted}",
        f"does not name frames of {what}, which has {count}",
        "Give all, or FIRST:LAST for FIRST to LAST-1, counted from 0.",
    )


def _in_folder(folder: Path) -> list[SceneFrame]:
    files = {file.stem: file for file in folder.glob("*.xml")}
    files |= {file.parent.name: file for file in folder.glob("*/scene.xml")}
    found = [SceneFrame(name, file) for name, file in files.items() if re.search(r"\d", name)]
    if not found:
        raise UserError(
            str(folder),
            "has no frames",
            "Name its scene files, or the folders with a scene.xml, by number: frame_0001.xml.",
        )
    return found


def _by_parameter(file: Path) -> list[SceneFrame]:
    document = read_scene_xml(file, {PARAMETER: _ANY})
    if PARAMETER not in document.parameters:
        raise UserError(
            str(file),
            f"does not move: it has no parameter ${PARAMETER}",
            f"Write ${PARAMETER} in the names of its files, or give a folder of scene files.",
        )
    values: set[str] | None = None
    for reference in document.references:
        if _ANY in reference.text:
            here = _values(reference.path)
            values = here if values is None else values & here
    if not values:
        raise UserError(
            str(file),
            f"has no frames: there is no value of ${PARAMETER} for which all its files exist",
            "Check the names of the files.",
        )
    return [SceneFrame(f"{file.stem}_{value}", file, {PARAMETER: value}) for value in values]


def _values(path: Path) -> set[str]:
    """The numbers that, in place of the parameter, give a file that exists."""
    depth = next(i for i, part in enumerate(path.parts) if _ANY in part)
    folder, part = Path(*path.parts[:depth]), path.parts[depth]
    first, *rest = part.split(_ANY)
    pattern = re.escape(first) + r"(-?\d+)" + r"\1".join(re.escape(text) for text in rest)
    found = set()
    for entry in folder.iterdir() if folder.is_dir() else ():
        if match := re.fullmatch(pattern, entry.name):
            value = match[1]
            if Path(str(path).replace(_ANY, value)).exists():
                found.add(value)
    return found


def _number(name: str) -> int:
    # A minus counts after _ or a dot; that of frame-0001 is a separator itself.
    return int(re.findall(r"(?<![^_.])-\d+|\d+", name)[-1])

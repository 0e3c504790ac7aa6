"""Checks of a scene file before it is imported.

They do not need Mitsuba. Their messages give the file and the line.
"""

from __future__ import annotations

import os
import re
from pathlib import Path, PureWindowsPath

from gpf.core.errors import UserError
from gpf.core.places import place_below
from gpf.scene.xml import Reference, SceneXml, Tag

CAMERAS = ("perspective", "thinlens")
"""Types of sensors that can become views."""

RESERVED = ("build.py", "scene.xml", "views.yaml")
"""Files with a special role in a scene's folder."""


def check_scene_xml(document: SceneXml, xml: Path) -> None:
    """Check a scene file and all files that it includes or refers to.

    Raises
    ------
    UserError: it is not a scene, or does not say for which version of Mitsuba; no sensor can
        become a view; a file is missing or outside the folder of ``xml``; an emitter cannot emit
        photons.
    """
    for tag in document.tags:
        if tag.is_root:
            _check_version(tag)
    root = document.tags[0]
    if root.name != "scene":
        raise UserError(
            str(root.place), f"begins with <{root.name}>", "Name a file that begins with <scene>."
        )
    for reference in document.references:
        _check_reference(reference, xml.parent)
    _check_sensors(document)
    for tag in document.tags:
        if tag.name == "emitter" and tag.attributes.get("type") == "timed_sunsky":
            raise UserError(
                str(tag.place),
                "has an emitter of type timed_sunsky, which cannot emit photons in Mitsuba 3.9",
                "Use sunsky, which is the sky at one moment.",
            )


def describe_leftovers(document: SceneXml, xml: Path) -> list[str]:
    """Describe the files of the folder and the sensors that are not imported."""
    found = []
    used = {xml.resolve(), *(file.resolve() for file in document.files())}
    beside = sorted(xml.parent.glob("*.[xX][mM][lL]"))
    unused = [p.name for p in beside if p.resolve() not in used and not p.name.startswith(".")]
    if unused:
        found.append(f"not imported: {', '.join(unused)} (not referenced)")
    sensors = _sensors(document)
    others = [tag for tag in sensors if not _is_camera(tag)]
    for tag in others:
        kind = tag.attributes.get("type")
        found.append(f"the {kind} sensor in line {tag.place.line} is not a camera: not imported")
    cameras = len(sensors) - len(others)
    if cameras > 1:
        found.append(
            f"it has {cameras} cameras: the first sets the aspect ratio, any can become a view"
        )
    for name in ("build.py", "views.yaml"):
        if (xml.parent / name).exists():
            found.append(f"not imported: {name} (views are placed afresh, nothing is built)")
    return found


def _check_version(root: Tag) -> None:
    version = root.attributes.get("version")
    if version is None:
        raise UserError(
            str(root.place),
            f"<{root.name}> has no version",
            'Add version="3.0.0", or "0.6.0" if parameter names look like toWorld.',
        )
    if not re.fullmatch(r"\d+\.\d+\.\d+", version):
        raise UserError(
            str(root.place), f"has the version {version!r}", 'Write three numbers, as in "3.0.0".'
        )


def _check_sensors(document: SceneXml) -> None:
    sensors = _sensors(document)
    if not sensors:
        raise UserError(
            str(document.tags[0].place),
            "the scene has no sensor",
            "Add a perspective <sensor>: views are placed around it.",
        )
    if not any(_is_camera(tag) for tag in sensors):
        tag = sensors[0]
        raise UserError(
            str(tag.place),
            f"the sensor is of type {tag.attributes.get('type')}",
            f"Views need one of type {' or '.join(CAMERAS)}.",
        )


def _sensors(document: SceneXml) -> list[Tag]:
    return [tag for tag in document.tags if tag.name == "sensor"]


def _is_camera(tag: Tag) -> bool:
    return tag.attributes.get("type") in CAMERAS


def _check_reference(reference: Reference, home: Path) -> None:
    """Check that a file exists below the folder ``home`` and that its copy can keep its name."""
    where, text, path = str(reference.place), reference.text, reference.path
    inward = "Copy it into the folder and refer to it by a relative path."
    if os.path.isabs(text) or PureWindowsPath(text).is_absolute():
        raise UserError(where, f"refers to {text} by an absolute path", inward)
    relative = os.path.normpath(os.path.relpath(path, home))
    if Path(relative).parts[:1] == ("..",) or not path.is_relative_to(home):
        raise UserError(
            where, f"refers to {text}, which is outside the scene's folder {home}", inward
        )
    if not path.exists():
        todo = "Put it there, or correct the scene file."
        if "\\" in text:
            todo = "Separate folders with / instead of \\."
        raise UserError(where, f"refers to {path}, which does not exist", todo)
    if not path.resolve().is_relative_to(home.resolve()):
        raise UserError(
            where,
            f"refers to {text}, a link to {path.resolve()}, which is outside the scene's folder "
            f"{home}",
            "Replace the link with the file itself.",
        )
    place_below(home, path.relative_to(home), where)
    if not (path.is_dir() if reference.is_folder else path.is_file()):
        raise UserError(
            where,
            f"refers to {path}, which is not a {'folder' if reference.is_folder else 'file'}",
            "Correct the scene file.",
        )
    if relative in RESERVED:
        raise UserError(
            where,
            f"refers to {text}, a name that is reserved in a scene's folder",
            "Give the file another name.",
        )

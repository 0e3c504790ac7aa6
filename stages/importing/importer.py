"""Import of a Mitsuba scene from elsewhere.

The new scene is made in a temporary folder beside the other scenes. The folder gets the scene's
name in the last step, so a failed import leaves nothing behind. Messages name the user's own files,
not the temporary ones.
"""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import mitsuba as mi

from gpf.core.errors import UserError
from gpf.core.partial import grant_as_usual, partial_folder, remove_leftovers
from gpf.core.places import make_place
from gpf.scene.folders import scenes_root
from gpf.scene.load import load_scene_file
from gpf.scene.sensors import (
    film_aspect,
    scene_cameras,
    shown_differently,
    views_of_sensors,
)
from gpf.scene.snapshot import make_folders
from gpf.scene.views import SceneViews, View
from gpf.scene.views_file import write_views
from gpf.scene.xml import SceneXml, read_scene_xml
from stages.importing.checks import check_scene_xml, describe_leftovers
from stages.importing.description import describe_scene
from stages.importing.report import PHOTONS, ImportReport, examine_scene
from stages.importing.sources import Source, open_source

PlaceViews = Callable[["mi.Scene", Sequence[View], float], SceneViews]
"""(scene, views of its own sensors, width / height of the first one's film) -> all views."""

NAME = r"[a-z][a-z0-9_]*"
RESERVED = (
    "code",
    "costs",
    "figures",
    "tables",
    *["true", "false", "null", "yes", "no", "on", "off", "y", "n"],
)
"""Names that a scene cannot have: other result folders, and words that YAML reads as values."""

PAPERS = ("licence", "license", "copying", "readme")
"""How the names of files about a scene's licence and origin begin."""


def import_scene(
    path: Path,
    name: str,
    place_views: PlaceViews,
    root: Path | None = None,
    photons: int = PHOTONS,
) -> ImportReport:
    """Make the scene ``name`` below ``root`` (default: :func:`gpf.scene.folders.scenes_root`).

    The scene file is copied as ``scene.xml``. The files that it refers to are copied to the same
    relative paths, and so are files about its licence and origin. The result of ``place_views`` is
    written to ``views.yaml``.

    Parameters
    ----------
    path: a folder, an XML file, or a zip archive that holds a scene.
    photons: number of photon paths, and of Gaussians, for which radii are proposed.

    Raises
    ------
    UserError: the name is taken or not allowed, or the scene is rejected by
        :mod:`stages.importing.sources`, :mod:`stages.importing.checks`,
        :func:`gpf.scene.load.load_scene_file` or :func:`stages.importing.report.examine_scene`.
    """
    root = root or scenes_root()
    check_name(name, root)
    try:
        remove_leftovers(root)
        with partial_folder(root / name) as work:
            with _users_paths({work / "unpacked": path}):
                source = open_source(path, work / "unpacked")
                report = _make(source, name, work / "scene", root, place_views, photons)
            (work / "scene").rename(root / name)
    except OSError as error:
        raise UserError(
            str(root / name),
            f"could not be created ({error})",
            "Free some disk space, or check the permissions of the files and folders.",
        ) from error
    return report


def check_name(name: str, root: Path) -> None:
    """Raise a :class:`UserError` unless a new scene can have this name."""
    if not re.fullmatch(NAME, name):
        better = re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")
        better = better if better[:1].isalpha() else f"scene_{better or 'of_mine'}"
        raise UserError(
            f"name {name!r}",
            "is not a lower-case letter followed by lower-case letters, digits and underscores",
            f"Try {better}.",
        )
    if name in RESERVED:
        raise UserError(f"name {name!r}", "is reserved", "Choose another name.")
    if os.path.lexists(root / name):
        raise UserError(
            f"name {name!r}",
            f"is taken: {root / name} exists",
            "Choose another name, or remove that folder first.",
        )


def _make(
    source: Source, name: str, target: Path, root: Path, place_views: PlaceViews, photons: int
) -> ImportReport:
    """Write the whole scene into the folder ``target``."""
    document = read_scene_xml(source.xml)
    check_scene_xml(document, source.xml)
    copied = copy_files(source, document, target)
    size = sum(file.stat().st_size for file in copied)
    with _users_paths({target / "scene.xml": source.xml, target: source.xml.parent}):
        scene = load_scene_file(target / "scene.xml", *_film_size(document))
        own = views_of_sensors(scene)
        if not own:
            raise UserError(
                str(source.xml),
                "has no perspective sensor at the top level of the scene",
                "Move the sensor out of the element that contains it.",
            )
        aspect = film_aspect(scene_cameras(scene)[0])
        found = examine_scene(scene, own[0], aspect, str(source.xml), photons)
        views = place_views(scene, own, aspect)
    warnings = describe_leftovers(document, source.xml) + shown_differently(scene)
    write_views(
        target / "views.yaml",
        views,
        f"Cameras of {name}, placed around its camera; gpf/scene/views.py describes the format.",
    )
    report = ImportReport(
        name, root / name, source.origin, len(copied), size, found, views, tuple(warnings)
    )
    if not any(file.name.lower().startswith("readme") for file in copied):
        (target / "README.md").write_text(describe_scene(report, target), encoding="utf-8")
    grant_as_usual(target)
    return report


def copy_files(source: Source, document: SceneXml, target: Path) -> list[Path]:
    """Copy a scene that :mod:`stages.importing.checks` accepted; return the copies."""
    home = source.xml.parent
    copies = {make_place(target, "scene.xml", str(source.xml)): source.xml}
    for file in document.files():
        copies[make_place(target, file.relative_to(home), str(source.xml))] = file
    for folder in (home, *home.parents):  # of licences with the same name, the nearest is copied
        if folder.is_relative_to(source.folder):
            for file in sorted(folder.iterdir()):
                is_paper = file.is_file() and file.name.lower().startswith(PAPERS)
                if is_paper and file.resolve().is_relative_to(source.folder.resolve()):
                    copies.setdefault(make_place(target, file.name, str(file)), file)
    make_folders(source.xml, target)
    for copy, file in copies.items():
        shutil.copyfile(file, copy)
    return list(copies)


def _film_size(document: SceneXml) -> tuple[int, int]:
    """The film size among the default parameters of the scene file; else 256 × 256."""
    width, height = (document.defaults.get(key, "") for key in ("resx", "resy"))
    return (
        int(width) if width.isdecimal() else 256,
        int(height) if height.isdecimal() else 256,
    )


@contextmanager
def _users_paths(names: dict[Path, Path]) -> Iterator[None]:
    """Replace each temporary path (key) in error messages with the user's own (value), in order."""
    try:
        yield
    except UserError as error:
        texts = [error.where, error.what, error.todo]
        for temporary, own in names.items():
            texts = [text.replace(str(temporary), str(own)) for text in texts]
        raise UserError(*texts) from None

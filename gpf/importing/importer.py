"""Somebody else's Mitsuba scene -> a scene of the project.

Everything is made in a temporary folder beside the scenes, which gets its name at the very end:
whatever happens before, no half-made scene remains. A :class:`gpf.core.errors.UserError` names the
user's own files, not the temporary ones.
"""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import mitsuba as mi

from gpf.core.errors import UserError
from gpf.importing.checks import check_scene_xml, describe_leftovers
from gpf.importing.description import describe_scene
from gpf.importing.report import SceneReport, examine_scene
from gpf.importing.sources import Source, open_source
from gpf.scene.folders import scenes_root
from gpf.scene.load import load_scene_file
from gpf.scene.sensors import (
    differs_from_view,
    film_aspect,
    looks_through,
    scene_cameras,
    views_of_sensors,
)
from gpf.scene.snapshot import make_folders
from gpf.scene.views import SceneViews, View
from gpf.scene.views_file import write_views
from gpf.scene.xml import SceneXml, read_scene_xml

PlaceViews = Callable[["mi.Scene", Sequence[View], float], SceneViews]
"""From the scene, the views of its own sensors and the aspect of the first to all its views."""

NAME = r"[a-z][a-z0-9_]*"
RESERVED = (
    "code",
    "costs",
    "figures",
    "tables",
    *["true", "false", "null", "yes", "no", "on", "off", "y", "n"],
)
"""Folders that the pipeline writes beside those of the scenes, and what YAML takes for no text."""

PAPERS = ("licence", "license", "copying", "readme")
"""Files that say where a scene comes from begin with one of these."""


@dataclass(frozen=True)
class ImportReport:
    """What was imported.

    Attributes
    ----------
    name, folder: of the new scene. origin: name of the folder, file or archive it came from.
    files, size: number of files that were copied, and their bytes.
    scene: what was found out about it.
    views: those that were placed.
    warnings: what was left behind or is shown otherwise, in words.
    """

    name: str
    folder: Path
    origin: str
    files: int
    size: int
    scene: SceneReport
    views: SceneViews
    warnings: tuple[str, ...]


def import_scene(
    path: Path,
    name: str,
    place_views: PlaceViews,
    root: Path | None = None,
    photons: int = 100_000,
) -> ImportReport:
    """Make the scene ``name`` below ``root`` (default: :func:`gpf.scene.folders.scenes_root`).

    Copied are the scene file, as ``scene.xml``, all that it refers to, at the same relative paths,
    and files that tell of licence and origin. ``views.yaml`` gets what ``place_views`` answers.

    Parameters
    ----------
    path: a folder, an XML file, or a zip archive with one.
    photons: number of photon paths and of Gaussians that radii are proposed for.

    Raises
    ------
    UserError: the name is taken or no name, or what :mod:`gpf.importing.sources`,
        :mod:`gpf.importing.checks`, :func:`gpf.scene.load.load_scene_file` and
        :func:`gpf.importing.report.examine_scene` object to.
    """
    root = root or scenes_root()
    check_name(name, root)
    try:
        work = Path(tempfile.mkdtemp(dir=root, prefix=".import-"))
        try:
            with _users_words({work / "unpacked": path}):
                source = open_source(path, work / "unpacked")
                report = _make(source, name, work / "scene", root, place_views, photons)
            (work / "scene").rename(root / name)
        finally:
            shutil.rmtree(work, ignore_errors=True)
    except OSError as error:
        raise UserError(
            str(root / name),
            f"could not be made ({error})",
            "Free some disk space, or check who may read and write there.",
        ) from error
    return report


def check_name(name: str, root: Path) -> None:
    """Raise a :class:`UserError` unless a new scene can be called so."""
    if not re.fullmatch(NAME, name):
        better = re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")
        better = better if better[:1].isalpha() else f"scene_{better or 'of_mine'}"
        raise UserError(
            f"name {name!r}",
            "is not a small letter followed by small letters, digits and underscores",
            f"Take for instance {better}.",
        )
    if name in RESERVED:
        raise UserError(f"name {name!r}", "means something else already", "Choose another name.")
    if os.path.lexists(root / name):
        raise UserError(
            f"name {name!r}",
            f"is taken: there is {root / name}",
            "Choose another name, or remove that folder first.",
        )


def _make(
    source: Source, name: str, target: Path, root: Path, place_views: PlaceViews, photons: int
) -> ImportReport:
    """Fill the folder ``target`` with the whole scene."""
    document = read_scene_xml(source.xml)
    check_scene_xml(document, source.xml)
    copied = copy_files(source, document, target)
    size = sum(file.stat().st_size for file in copied)
    with _users_words({target / "scene.xml": source.xml, target: source.xml.parent}):
        scene = load_scene_file(target / "scene.xml", *_film_size(document))
        own = views_of_sensors(scene)
        cameras = scene_cameras(scene)
        if not own:
            raise UserError(
                str(source.xml),
                "has no perspective sensor of its own",
                "Take the sensor out of what it is nested in.",
            )
        aspect = film_aspect(cameras[0])
        found = examine_scene(scene, own[0], aspect, str(source.xml), photons)
        views = place_views(scene, own, aspect)
    warnings = describe_leftovers(document, source.xml)
    for camera, view in zip(cameras, own, strict=True):
        warnings += [f"sensor {view.name} {what}" for what in differs_from_view(camera, view)]
        warnings += [f"sensor {view.name} {what}" for what in looks_through(scene, camera, view)]
    write_views(
        target / "views.yaml",
        views,
        f"Cameras of {name}, placed around the scene's own; gpf/scene/views.py describes the format.",
    )
    report = ImportReport(
        name, root / name, source.origin, len(copied), size, found, views, tuple(warnings)
    )
    if not any(file.name.lower().startswith("readme") for file in copied):
        (target / "README.md").write_text(describe_scene(report, target), encoding="utf-8")
    target.chmod(0o755)
    return report


def copy_files(source: Source, document: SceneXml, target: Path) -> list[Path]:
    """Copy a scene that :mod:`gpf.importing.checks` has let pass; return the copies."""
    home = source.xml.parent
    copies = {target / "scene.xml": source.xml}
    for file in document.files():
        copies[target / file.relative_to(home)] = file
    for folder in (home, *home.parents):  # the nearest licence is the one that counts
        if folder.is_relative_to(source.folder):
            for file in sorted(folder.iterdir()):
                is_paper = file.is_file() and file.name.lower().startswith(PAPERS)
                if is_paper and file.resolve().is_relative_to(source.folder.resolve()):
                    copies.setdefault(target / file.name, file)
    make_folders(source.xml, target)
    for copy, file in copies.items():
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(file, copy)
    return list(copies)


def _film_size(document: SceneXml) -> tuple[int, int]:
    """The film size that the scene file itself has in mind, where it takes one as a parameter."""
    width, height = (document.defaults.get(key, "") for key in ("resx", "resy"))
    return (
        int(width) if width.isdecimal() else 256,
        int(height) if height.isdecimal() else 256,
    )


@contextmanager
def _users_words(names: dict[Path, Path]) -> Iterator[None]:
    """Let errors name the user's own files: each key is replaced by its value, in this order."""
    try:
        yield
    except UserError as error:
        texts = [error.where, error.what, error.todo]
        for temporary, own in names.items():
            texts = [text.replace(str(temporary), str(own)) for text in texts]
        raise UserError(*texts) from None

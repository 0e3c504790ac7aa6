"""Build the generated files of scenes, and copy complete scenes."""

from __future__ import annotations

import importlib.util
import os
import shutil
from pathlib import Path
from types import ModuleType

from gpf.core.errors import UserError
from gpf.core.partial import grant_as_usual, partial_folder, remove_leftovers, replace_folder
from gpf.core.places import make_place
from gpf.scene.folders import scene_files, scene_folder
from gpf.scene.load import load_scene_file
from gpf.scene.views import read_views
from gpf.scene.xml import read_scene_xml


def build_scene(name: str, root: Path | None = None, target: Path | None = None) -> list[Path]:
    """Run the ``build.py`` of a scene, if it has one, and return the files that it made.

    The files go below ``target``, by default the folder of the scene. The builder writes them to a
    temporary folder; they are moved once all are complete.
    """
    folder = scene_folder(name, root)
    target = target or folder
    script = folder / "build.py"
    if not script.exists():
        return []
    remove_leftovers(target)
    with partial_folder(target / "build") as staging:
        module = load_builder(script)
        if not hasattr(module, "build"):
            raise UserError(str(script), "has no function build", "Define build(folder: Path).")
        made = []
        for source in module.build(staging):
            place = make_place(target, source.relative_to(staging), str(script))
            os.replace(source, place)
            made.append(place)
        return made


def load_builder(script: Path) -> ModuleType:
    """The module in a scene's ``build.py``."""
    spec = importlib.util.spec_from_file_location(f"scene_builder_{script.parent.name}", script)
    assert spec is not None and spec.loader is not None  # the path ends in .py
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except ModuleNotFoundError as error:
        todo = "Install it. `scenes.modelling` is in the project's checkout: run `make venv` there."
        raise UserError(str(script), f"needs the module {error.name}", todo) from error
    return module


def snapshot_scene(name: str, target: Path, root: Path | None = None) -> None:
    """Make ``target`` a complete copy of a scene, with the files that its builder generates.

    All :func:`scene_files` except the builder are copied, so that the snapshot depends on no other
    folder; other files in ``target`` are deleted. The snapshot is loaded once before it replaces
    an older one: after a :class:`UserError`, the older one is unchanged.
    """
    folder = scene_folder(name, root)
    target.parent.mkdir(parents=True, exist_ok=True)
    with partial_folder(target) as staging:
        made = {p.relative_to(staging) for p in build_scene(name, root, staging)}
        references = read_scene_xml(folder / "scene.xml").references
        lines = {reference.path: str(reference.place) for reference in reversed(references)}
        for source in scene_files(name, root):
            where = lines.get(source, str(folder / "scene.xml"))
            inside = source.is_relative_to(folder)  # otherwise named by an absolute path
            if not inside or not source.resolve().is_relative_to(folder.resolve()):
                raise UserError(
                    where,
                    f"refers to {source}, which is outside the scene folder",
                    "Copy it into the folder and refer to it by a relative path.",
                )
            if source.name == "build.py" or source.relative_to(folder) in made:
                continue
            if not source.exists():
                raise UserError(
                    where,
                    f"refers to {source}, which does not exist",
                    "Put it there, or correct the scene file.",
                )
            shutil.copyfile(source, make_place(staging, source.relative_to(folder), where))
        make_folders(folder / "scene.xml", staging)
        try:
            views = read_views(staging / "views.yaml")
            load_scene_file(staging / "scene.xml", *views.size(16))
        except UserError as error:  # name the files of the scene, not the copies
            where, what = (t.replace(str(staging), str(folder)) for t in (error.where, error.what))
            raise UserError(where, what, error.todo) from None
        grant_as_usual(staging)
        replace_folder(staging, target)


def make_folders(file: Path, target: Path) -> None:
    """Create the folders below ``target`` that a scene file names in ``<path>``, even if empty."""
    for reference in read_scene_xml(file).references:
        if reference.is_folder and reference.path.is_relative_to(file.parent):
            name, where = reference.path.relative_to(file.parent), str(reference.place)
            make_place(target, name, where).mkdir(exist_ok=True)

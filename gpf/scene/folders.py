"""Scenes by name: their folders and files.

A scene is a folder ``scenes/<name>`` with

- ``scene.xml``: a Mitsuba scene,
- ``views.yaml``: its cameras (:mod:`gpf.scene.views`),
- ``build.py``, if meshes or textures are generated: ``build(folder: Path) -> list[Path]`` writes
  them below ``folder`` and returns their paths.
"""

from __future__ import annotations

import os
from pathlib import Path

from gpf.core.errors import UserError
from gpf.core.yaml import suggest
from gpf.scene.views import SceneViews, read_views
from gpf.scene.xml import read_scene_xml


def scenes_root() -> Path:
    """The folder that holds the scenes.

    ``$GPF_SCENES`` if it is set; else ``scenes`` in the nearest folder, from the current one
    upwards, that contains a ``params.yaml`` or a ``scenes/*/scene.xml``. Raises a
    :class:`UserError` if there is none.
    """
    chosen = os.environ.get("GPF_SCENES")
    if chosen:
        if not Path(chosen).is_dir():
            raise UserError(
                "GPF_SCENES", f"{chosen} is not a folder", "Set it to one, or unset it."
            )
        return Path(chosen)
    here = Path.cwd()
    for folder in (here, *here.parents):
        root = folder / "scenes"
        if root.is_dir() and ((folder / "params.yaml").exists() or any(root.glob("*/scene.xml"))):
            return root
    raise UserError(
        str(here),
        "neither this folder nor any above it has scenes",
        "Change to the project folder, or set GPF_SCENES to the folder that holds the scenes.",
    )


def list_scenes(root: Path | None = None) -> list[str]:
    """The names of all scenes below ``root`` (default: :func:`scenes_root`), sorted."""
    folders = [file.parent.name for file in (root or scenes_root()).glob("*/scene.xml")]
    return sorted(name for name in folders if not name.startswith("."))  # unfinished imports


def scene_folder(name: str, root: Path | None = None) -> Path:
    """The folder of a scene; raises a :class:`UserError` if there is no such scene."""
    root = root or scenes_root()
    known = list_scenes(root)
    if name not in known:
        raise UserError(f"scene {name!r}", "does not exist", suggest(name, known, "The scenes are"))
    return root / name


def scene_files(name: str, root: Path | None = None) -> list[Path]:
    """All files of a scene, sorted; files that ``build.py`` generates need not exist yet."""
    folder = scene_folder(name, root)
    own = [folder / "scene.xml", folder / "views.yaml", folder / "build.py"]
    referred = read_scene_xml(folder / "scene.xml").files()
    found = {file for file in own if file.exists()} | set(referred)
    return sorted(found)


def load_views(name: str, root: Path | None = None) -> SceneViews:
    """The views of a scene, with at least one training view (:func:`read_views`)."""
    return read_views(scene_folder(name, root) / "views.yaml")

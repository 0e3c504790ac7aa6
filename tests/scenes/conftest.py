"""The project's own scenes, built once for all tests."""

import shutil
from pathlib import Path

import pytest

from gpf.scene.folders import list_scenes
from gpf.scene.snapshot import build_scene
from tests.made_once import made_once

PROJECT = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def root(tmp_path_factory) -> Path:
    """A copy of the project's scenes, built; one for all processes that run tests."""
    return made_once(tmp_path_factory, "built_scenes", _build_all)


def _build_all(root: Path) -> None:
    made = shutil.ignore_patterns("meshes", "textures", "__pycache__")
    for name in list_scenes(PROJECT / "scenes"):
        shutil.copytree(PROJECT / "scenes" / name, root / name, ignore=made)
        build_scene(name, root)

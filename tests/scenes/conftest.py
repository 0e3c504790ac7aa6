"""The project's own scenes, built once for all tests."""

import shutil
from pathlib import Path

import pytest

from gpf import scene_folders, scene_freezing

PROJECT = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def root(tmp_path_factory) -> Path:
    """A copy of the project's scenes, built."""
    root = tmp_path_factory.mktemp("scenes")
    made = shutil.ignore_patterns("meshes", "textures", "__pycache__")
    for name in scene_folders.list_scenes(PROJECT / "scenes"):
        shutil.copytree(PROJECT / "scenes" / name, root / name, ignore=made)
        scene_freezing.build_scene(name, root)
    return root

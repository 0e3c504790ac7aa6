"""A folder with the Cornell Box and its field."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from gpf.field.io import save_field
from gpf.scene.fingerprint import fingerprint
from gpf.scene.load import load_scene_file
from tests.commands.box import SOURCE, box_field


@pytest.fixture(scope="session")
def made(tmp_path_factory) -> Path:
    """A folder with the Cornell Box, and a field that has E = 1 on all of its surfaces."""
    folder = tmp_path_factory.mktemp("box")
    shutil.copyfile(SOURCE / "scene.xml", folder / "box.xml")
    scene = load_scene_file(folder / "box.xml")
    field = box_field(scene)
    field.record = {"fingerprint": fingerprint(scene), "exposure": 1.5}
    save_field(field, folder / "field.safetensors")
    return folder


@pytest.fixture
def box(made, tmp_path, monkeypatch) -> Path:
    folder = tmp_path / "box"
    shutil.copytree(made, folder)
    monkeypatch.chdir(folder)
    return folder

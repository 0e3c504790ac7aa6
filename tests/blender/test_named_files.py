"""Which files a scene file of another format names, of which a change converts it again."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from gpf.blender.conversion import RECORD, converted
from gpf.core.files import read_json
from tests.blender.test_against_cycles import PYTHON

TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"

pytestmark = pytest.mark.skipif(PYTHON is None, reason="no Blender: gpf blender-install")


def write_obj(folder: Path) -> Path:
    (folder / "my paint.mtl").write_text("newmtl m\nKd 1 0 0\n")
    (folder / "scene.obj").write_text("mtllib my paint.mtl\n" + TRIANGLE)
    return folder / "scene.obj"


def write_gltf(folder: Path) -> Path:
    (folder / "the data.bin").write_bytes(bytes(36))
    described = {
        "asset": {"version": "2.0"},
        "buffers": [{"uri": "the%20data.bin", "byteLength": 36}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}
            | {"min": [0, 0, 0], "max": [0, 0, 0]}
        ],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "nodes": [{"mesh": 0}],
        "scenes": [{"nodes": [0]}],
        "images": [{"uri": "data:,"}],
    }
    (folder / "scene.gltf").write_text(json.dumps(described))
    return folder / "scene.gltf"


def write_usd(folder: Path) -> Path:
    ball = '#usda 1.0\n(defaultPrim="Ball")\ndef Sphere "Ball" {}\n'
    (folder.parent / "ball.usda").write_text(ball)
    layers = "#usda 1.0\n(subLayers = [@./missing.usda@])\n"
    named = 'def Xform "A" (references = @../ball.usda@) {}\n'
    (folder / "scene.usda").write_text(layers + named)
    return folder / "scene.usda"


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    ("write", "names"),
    [
        (write_obj, ["my paint.mtl"]),
        (write_gltf, ["the data.bin"]),
        (write_usd, ["../ball.usda", "missing.usda"]),
    ],
)
def test_what_is_named_counts_and_what_lies_beside_does_not(tmp_path, monkeypatch, write, names):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("GPF_BLENDER", str(PYTHON))
    folder = tmp_path / "scenes"
    folder.mkdir()
    file = write(folder)
    found = converted(file, print)
    known = set(map(os.path.normpath, read_json(found.folder / RECORD)["files"]))
    assert {os.path.normpath(folder / name) for name in names} <= known
    (folder / "picture.png").write_bytes(b"of ours")
    assert not is_read(file)
    with (folder / names[-1]).open("a") as changed:
        changed.write("# more\n")
    assert is_read(file)


def is_read(file: Path) -> bool:
    """Whether Blender reads a file once more."""
    said: list[str] = []
    converted(file, said.append)
    return "opening" in said

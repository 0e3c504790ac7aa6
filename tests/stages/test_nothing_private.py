"""No file that is made has a path of the machine, the home folder or a word of the environment."""

from __future__ import annotations

import base64
import binascii
import re
import shutil
import socket
import sys
import zlib
from collections.abc import Iterator
from pathlib import Path

import pytest

from gpf.cli import main
from gpf.core.files import read_json
from tests.small_fit import make_small
from tests.stages.conftest import PROJECT
from tests.stages.importing.foreign_scene import place_two, write_original

SECRET = "hf_7dQsecretTokenOfTheUser"
FOLDER = "somebodys_private_folder"


def texts(data: bytes) -> Iterator[bytes]:
    """The bytes of a file, and what is packed in them: base64, and streams of zlib or gzip."""
    yield data
    for found in re.finditer(rb"[A-Za-z0-9+/]{60,}={0,2}", data):
        try:
            inner = base64.b64decode(found[0])
        except binascii.Error:
            continue
        yield inner
        yield from unpacked(inner)
    yield from unpacked(data)


def unpacked(data: bytes) -> Iterator[bytes]:
    for found in re.finditer(rb"x[\x01\x5e\x9c\xda]|\x1f\x8b\x08", data):
        try:
            yield zlib.decompressobj(zlib.MAX_WBITS | 32).decompress(data[found.start() :])
        except zlib.error:
            continue


def private(folder: Path, words: tuple[str, ...]) -> list[str]:
    """The files below a folder that have one of the words, and the word."""
    return [
        f"{path.relative_to(folder)}: {word}"
        for path in sorted(folder.rglob("*"))
        if path.is_file()
        for word in words
        if any(word.encode() in text for text in texts(path.read_bytes()))
    ]


def places() -> tuple[str, ...]:
    """Folders of this machine; its name and the user's, unless short or common."""
    home = str(Path.home())
    common = ("localhost", "runner", "ubuntu", "docker")
    names = (socket.gethostname().partition(".")[0], Path.home().name)
    told = tuple(name for name in names if len(name) > 5 and name not in common)
    return (str(PROJECT), *((home,) if len(Path(home).parts) > 2 else (f"{home}/",)), *told)


def test_the_search_finds_what_is_packed(tmp_path):
    plain = b"x" * 40 + f"/home/{FOLDER}/scene.xml".encode() + b"y" * 40
    (tmp_path / "plain").write_bytes(plain)
    (tmp_path / "page.html").write_bytes(b'"data:;base64,' + base64.b64encode(plain) + b'"')
    (tmp_path / "packed").write_bytes(b"head" + zlib.compress(plain))
    both = base64.b64encode(zlib.compress(plain + bytes(range(256))))
    (tmp_path / "both").write_bytes(b'<i "' + both + b'">')
    (tmp_path / "none").write_bytes(b"/home/somebody_else")
    found = [line.partition(":")[0] for line in private(tmp_path, (FOLDER,))]
    assert found == ["both", "packed", "page.html", "plain"]


def test_results_of_the_pipeline(built):
    assert "built_project" in str(built.folder)
    assert (built.folder / "results" / "report.html").exists()
    assert private(built.folder / "results", ("built_project", *places())) == []


def test_reasons_for_missing_numbers(finished, tmp_path, monkeypatch):
    """They name folders on the terminal alone."""
    hidden = tmp_path / FOLDER / "code"
    (hidden / "flip_evaluator").mkdir(parents=True)
    broken = f"raise ImportError('{hidden}/libflip.so: undefined symbol')\n"
    (hidden / "flip_evaluator" / "__init__.py").write_text(broken)
    monkeypatch.syspath_prepend(str(hidden))
    monkeypatch.delitem(sys.modules, "flip_evaluator", raising=False)
    for variable in ("GPF_RENDERFORMER", "GPF_LPIPS_WEIGHTS"):
        monkeypatch.setenv(variable, str(hidden))
    finished.edit("params.yaml", methods__learned=["renderformer"])
    told = finished.stage("baseline", more=("--method", "renderformer", "--go-on"))
    assert f"GPF_RENDERFORMER={hidden} has no" in told.text and told.code == 0
    finished.run("metrics", "report")
    page = (finished.folder / "results" / "report.html").read_text(encoding="utf-8")
    assert "has no renderformer/pipelines" in page
    reasons = read_json(finished.results / "metrics" / "path_10.json")["reasons"]
    assert {"lpips", "flip", "flip_hdr"} == set(reasons)
    assert private(finished.folder / "results", (FOLDER, *places())) == []


def test_what_the_commands_write(tmp_path, monkeypatch, capsys):
    make_small(monkeypatch, passes=2, steps=4, paths=2000)
    monkeypatch.setenv("HF_TOKEN", SECRET)
    monkeypatch.setattr("stages.commands.scene_import.place_views", place_two)
    home = tmp_path / FOLDER
    shutil.copytree(PROJECT / "scenes" / "cornell_box", home / "scenes" / "cornell_box")
    write_original(home / "Their Room")
    monkeypatch.chdir(home)
    scene, field = home / "scenes" / "cornell_box" / "scene.xml", home / "out" / "field.safetensors"
    out = home / "out"
    for words in (
        ("fit", scene, "--output", field, "--passes", "2", "--groups", "auto"),
        ("render", scene, "--field", field, "--output", out / "pictures", "--size", "20x16"),
        ("export", field, "--ply", out / "a.ply", "--compact", out / "a.safetensors"),
        ("scene", "import", home / "Their Room", "--name", "room"),
    ):
        with pytest.raises(SystemExit) as ended:
            main([*map(str, words), *(("--spp", "1") if words[0] == "render" else ())])
        assert not ended.value.code, capsys.readouterr().err
    assert {path.suffix for path in out.rglob("*")} >= {".safetensors", ".exr", ".png", ".json"}
    words = (FOLDER, SECRET, *places())
    assert private(out, words) == private(home / "scenes" / "room", words) == []

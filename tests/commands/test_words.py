"""What the commands say of scenes and fields that are not there, or are something else, and their
help."""

from __future__ import annotations

import io
import re
from contextlib import redirect_stdout
from pathlib import Path

import numpy as np
import pytest
import typer

from gpf.cli import app, main
from gpf.field.io import load_field, save_field
from gpf.scene.load import load_scene_file
from tests.commands.box import SOURCE

OF_SCENES = ("fit", "render", "view", "bake", "mitsuba")
OF_FIELDS = ("export", "info")


@pytest.fixture
def elsewhere(tmp_path, monkeypatch) -> Path:
    """A folder without a field, as users have it who installed the library alone."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("gpf.commands.scenes.CHECKOUT", None)
    return tmp_path


def said(capsys, *words: str) -> str:
    """What a refused command says."""
    with pytest.raises(SystemExit) as ended:
        main(words)
    assert ended.value.code == 2
    return " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize("command", OF_SCENES)
@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("foo", r"foo: is neither a file nor a scene with results/foo/.*\. Check the path\."),
        ("foo.xml", r"foo\.xml: does not exist\. Check the path\."),
        ("foo.blend", r"foo\.blend: does not exist\. Check the path\."),
        ("part.stl", r"part\.stl: is not a scene\. Give a file whose name ends in \.xml, \.blend"),
        ("a.safetensors", r"a\.safetensors: is not a scene\. Give a file whose name ends in \.xml"),
    ],
)
def test_what_is_no_scene(elsewhere, capsys, command, name, words):
    """With or without a field, and without a word of the stages of a checkout."""
    for file in ("part.stl", "a.safetensors"):
        Path(file).write_bytes(b"solid")
    assert re.fullmatch(f"error: {words}.*", text := said(capsys, command, name)), text
    assert sorted(path.name for path in elsewhere.iterdir()) == ["a.safetensors", "part.stl"]


@pytest.mark.parametrize("command", ["render", "bake", *OF_FIELDS])
@pytest.mark.parametrize(
    ("name", "words"),
    [
        (None, r"field\.safetensors: does not exist\. Run `gpf fit SCENE`, or name a field\."),
        ("foo", r"foo: is neither a file nor a scene with results/foo/.*\. Check the path\."),
        ("a.safetensors", r"a\.safetensors: does not exist\. Check the path\."),
        ("box.xml", r"box\.xml: is not a field\. Give a file whose name ends in \.safetensors\."),
    ],
)
def test_what_is_no_field(elsewhere, capsys, command, name, words):
    Path("box.xml").write_text((SOURCE / "scene.xml").read_text())
    scene = () if command in OF_FIELDS else ("box.xml", *(["--field"] if name else []))
    more = ("--ply", "a.ply") if command == "export" else ()
    text = said(capsys, command, *scene, *([name] if name else []), *more)
    assert re.fullmatch(f"error: {words}", text), text


def test_a_stage_is_advised_only_for_a_scene_of_the_project(elsewhere, monkeypatch, capsys):
    (elsewhere / "scenes" / "foo").mkdir(parents=True)
    (elsewhere / "scenes" / "foo" / "scene.xml").touch()
    assert "Check the path." in said(capsys, "fit", "foo")
    monkeypatch.setattr("gpf.commands.scenes.CHECKOUT", elsewhere)
    assert "Run `gpf stage scene --scene foo`." in said(capsys, "fit", "foo")
    assert "Check the path." in said(capsys, "fit", "fooo")


def test_what_a_field_is(box, capsys):
    field = load_field(box / "field.safetensors")
    scene = load_scene_file(box / "box.xml")
    assert scene.id() == "box"
    told = {"date": "2026-11-29 08:15 UTC", "passes": 36, "seconds": 40.4, "name": "box"}
    field.record |= told | {"fields": [(9, 30.04), (36, 41.26)]}
    field.set_error(np.full(len(field.gaussians.means.numpy().T), 0.02, np.float32))
    save_field(field, box / "field.safetensors")
    with pytest.raises(SystemExit) as ended:
        main(["info"])
    assert not ended.value.code
    lines = capsys.readouterr().out.splitlines()
    assert re.fullmatch(r"field +\d,\d{3} Gaussians, 0\.\d MB", lines[0])
    assert lines[1:] == [
        "scene    box, 2 x 2.01 x 2 units",
        "fit      2026-11-29 08:15 UTC, 36 passes in 40 s",
        "quality  36 passes, estimated PSNR 41.3 dB (after 9: 30.0 dB)",
        "error    2.0% of the light, at half of the Gaussians less",
        "light    all",
        "groups   none; `gpf fit --groups auto` keeps them apart",
    ]


def test_flags_have_no_type():
    def names(command, words=()):
        yield words
        for name, inner in getattr(command, "commands", {}).items():
            yield from names(inner, (*words, name))

    for words in names(typer.main.get_command(app)):
        shown = io.StringIO()
        with redirect_stdout(shown), pytest.raises(SystemExit):
            main([*words, "--help"])
        assert "--help" in shown.getvalue() and "bool" not in shown.getvalue().lower(), words

"""``gpf fit``: its files, its options, and what it says."""

from __future__ import annotations

import re
from pathlib import Path

import mitsuba as mi
import pytest

from gpf.cli import main
from gpf.commands.fit import describe_fit
from gpf.field.io import read_field
from gpf.scene.views import read_views
from tests.small_fit import make_small

SOURCE = Path(__file__).parents[2] / "scenes" / "cornell_box" / "scene.xml"


def test_what_gathered_light_was_worth_is_told():
    told = describe_fit({"fields": [(24, 30.0), (24, 34.04)]})
    assert told == "24 passes, estimated PSNR 34.0 dB (from photons alone: 30.0 dB)"


@pytest.mark.slow
def test_the_command_writes_a_field_and_a_picture(tmp_path, monkeypatch, capsys):
    make_small(monkeypatch, passes=30, steps=60, paths=5_000)
    for name in ("PREVIEW_ROWS", "ROWS"):
        monkeypatch.setattr(f"gpf.commands.fit.{name}", 32)
    with pytest.raises(SystemExit) as ended:
        main(["fit", str(SOURCE), "-o", str(tmp_path / "box.safetensors"), "--passes", "24"])
    assert not ended.value.code
    assert f"cameras: from {SOURCE.parent / 'views.yaml'}" in capsys.readouterr().err
    stored = read_field(tmp_path / "box.safetensors")
    assert stored.record["passes"] == 24 and stored.record["name"] == "cornell_box"
    assert re.fullmatch(r"\d{4}-\d\d-\d\d \d\d:\d\d UTC", stored.record["date"])
    assert stored.record["exposure"] == read_views(SOURCE.parent / "views.yaml").exposure
    assert stored.tensors["error"].shape == (len(stored.tensors["means"]),)
    assert tuple(mi.Bitmap(str(tmp_path / "box.png")).size()) == (32, 32)


@pytest.mark.parametrize("command", ["fit", "view"])
@pytest.mark.parametrize("name", ["box.exr", "box.fit", "box", "."])
def test_a_field_has_a_name_of_its_own(tmp_path, monkeypatch, capsys, command, name):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as ended:
        main([command, str(SOURCE), "-o", name])
    assert ended.value.code == 2 and not list(tmp_path.iterdir())
    assert "ends in .safetensors" in capsys.readouterr().err


def test_a_field_that_exists_is_not_replaced(tmp_path, capsys):
    out = tmp_path / "box.safetensors"
    out.write_text("mine")
    with pytest.raises(SystemExit) as ended:
        main(["fit", str(SOURCE), "-o", str(out)])
    assert ended.value.code == 2 and out.read_text() == "mine"
    said = " ".join(capsys.readouterr().err.split())
    assert "already exists. Add --overwrite to replace it, or add photons with --continue" in said


def test_a_fit_that_goes_on_has_its_place(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["fit", str(SOURCE), "--continue", "a.safetensors", "-o", "b.safetensors"])
    assert ended.value.code == 2
    assert "--continue and --output: are mutually exclusive" in capsys.readouterr().err

"""Blender as a process: missing, hanging, failing, and files that are not what they seem."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from gpf.blender import process
from gpf.blender.conversion import RECORD, convert, converted
from gpf.commands.convert import convert_file
from gpf.commands.scenes import find_frames, find_scene
from gpf.core.errors import UserError
from gpf.core.files import write_json


@pytest.fixture
def scene_file(tmp_path):
    path = tmp_path / "scene.blend"
    path.write_bytes(b"BLENDER of a kind")
    return path


@pytest.fixture
def blender(tmp_path, monkeypatch):
    """Make a program that stands for Blender; it gets the file and the folder as $1 and $2."""

    def make(script: str) -> None:
        path = tmp_path / "blender-stand-in"
        path.write_text(f'#!/bin/sh\nwhile [ "$1" != -- ]; do shift; done\nshift\n{script}\n')
        path.chmod(path.stat().st_mode | stat.S_IXUSR)
        monkeypatch.setenv(process.VARIABLE, str(path))

    return make


EMPTY = {
    **{"blender": "1.2", "size": [4, 3], "exposure": 1.0, "cameras": [], "world": None},
    **{"lamps": [], "shapes": [], "groups": {}, "instances": [], "closures": [], "images": {}},
    **{
        "missing_images": ["wood (//wood.png)"],
        "missing_libraries": [],
        "files": [],
        "notes": ["hair: left out"],
    },
}
SUN = {
    **{
        "name": "sun",
        "type": "SUN",
        "angle": 0,
        "matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]],
    },
    **{"color": [1, 1, 1], "energy": 3.0},
}


def test_without_blender_the_message_names_the_command(scene_file, tmp_path, monkeypatch):
    monkeypatch.delenv(process.VARIABLE, raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(process, "installed_python", lambda: tmp_path / "none")
    monkeypatch.setattr(process.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(UserError, match="gpf blender-install"):
        convert(scene_file, tmp_path / "out", print)
    assert not (tmp_path / "out").exists()


def test_a_variable_that_names_nothing(scene_file, tmp_path, monkeypatch):
    monkeypatch.setenv(process.VARIABLE, str(tmp_path / "nothing"))
    with pytest.raises(UserError, match="GPF_BLENDER"):
        convert(scene_file, tmp_path / "out", print)


@pytest.mark.parametrize(
    ("script", "words"),
    [
        ("echo gpf-error: is of no use; exit 2", "is of no use"),
        ("echo some last words >&2; exit 11", "exit code 11.*\nsome last words"),
        ("kill -9 $$", "exit code -9"),
        ("exit 0", "exit code 0"),
    ],
)
def test_blender_fails(blender, scene_file, tmp_path, script, words):
    blender(script)
    with pytest.raises(UserError, match=words):
        convert(scene_file, tmp_path / "out", print)
    assert not [p for p in tmp_path.iterdir() if p.name not in ("scene.blend", "blender-stand-in")]


def test_blender_hangs(blender, scene_file, tmp_path, monkeypatch):
    monkeypatch.setattr(process, "LIMIT", 0.3)
    blender("exec sleep 100")
    with pytest.raises(UserError, match="kept Blender busy"):
        convert(scene_file, tmp_path / "out", print)


def test_what_is_said_is_passed_on(blender, scene_file, tmp_path):
    write_json(tmp_path / "found.json", EMPTY)
    blender(f'echo gpf: geometry; echo noise; cp {tmp_path}/found.json "$2/scene.json"')
    said: list[str] = []
    made = convert(scene_file, tmp_path / "new" / "out", said.append)
    assert said == ["geometry", "writing the scene"] and made.notes == (
        "hair: left out",
        "image missing: wood (//wood.png)",
    )
    assert made.xml.is_file() and "hair" in (tmp_path / "new" / "out" / "converted.md").read_text()


def test_a_folder_of_something_else_is_not_replaced(blender, scene_file, tmp_path):
    write_json(tmp_path / "found.json", EMPTY)
    blender(f'cp {tmp_path}/found.json "$2/scene.json"')
    mine = tmp_path / "scene" / "mine.txt"
    convert_file(scene_file, None, overwrite=False)
    mine.write_text("notes")
    with pytest.raises(UserError, match="already exists"):
        convert_file(scene_file, None, overwrite=False)
    assert mine.is_file()
    convert_file(scene_file, None, overwrite=True)
    assert not mine.is_file() and (mine.parent / RECORD).is_file()
    (mine.parent / RECORD).unlink()
    with pytest.raises(UserError, match=f"has no {RECORD}"):
        convert_file(scene_file, None, overwrite=True)
    assert (mine.parent / "scene.xml").is_file()


def test_without_light_the_message_names_the_file(blender, scene_file, tmp_path, monkeypatch):
    write_json(tmp_path / "found.json", EMPTY)
    blender(f'cp {tmp_path}/found.json "$2/scene.json"')
    monkeypatch.setattr(
        "gpf.blender.conversion.platformdirs.user_cache_path", lambda _: tmp_path / "cache"
    )
    with pytest.raises(UserError, match=r"scene\.blend: has no lamp"):
        find_scene(str(scene_file))


def test_a_file_is_converted_again_when_it_or_what_it_uses_changes(
    blender, scene_file, tmp_path, monkeypatch
):
    image = tmp_path / "image.png"
    write_json(tmp_path / "found.json", EMPTY | {"files": [str(image)], "lamps": [SUN]})
    blender(f'echo once >> {tmp_path}/runs; cp {tmp_path}/found.json "$2/scene.json"')
    monkeypatch.setattr(
        "gpf.blender.conversion.platformdirs.user_cache_path", lambda _: tmp_path / "cache"
    )

    def runs() -> int:
        converted(scene_file, print)
        return len((tmp_path / "runs").read_text().splitlines())

    assert [runs(), runs()] == [1, 1]
    image.write_bytes(b"a")
    assert [runs(), runs()] == [2, 2]
    scene_file.write_bytes(b"BLENDER of another kind")
    assert [runs(), runs()] == [3, 3]
    xml, _ = find_scene(str(scene_file))
    assert xml.is_file() and (xml.parent / RECORD).is_file()
    assert (xml.parent.stat().st_mode & 0o777) == 0o777 & ~current_umask()


def test_a_part_of_an_animation_is_taken_from_the_whole(blender, scene_file, tmp_path, monkeypatch):
    """With it comes the frame before, from which a fit goes on, and the first one."""
    write_json(tmp_path / "frame.json", EMPTY | {"lamps": [SUN]})
    write_json(tmp_path / "frames.json", {"numbers": [3, 5, 7], "notes": ["baked twice"]})
    frames = " ".join(f"frame_000{number}.json" for number in (3, 5, 7))
    blender(
        f'cd "$2"; echo "$3" >> {tmp_path}/asked; cp {tmp_path}/frames.json .; '
        f"for frame in {frames}; do cp {tmp_path}/frame.json $frame; done"
    )
    monkeypatch.setattr(
        "gpf.blender.conversion.platformdirs.user_cache_path", lambda _: tmp_path / "cache"
    )
    for wanted in ("1:2", "1:2", "all", "0:1"):
        frames = find_frames(scene_file, wanted)
        assert [frame.name for frame in frames] == ["frame_0003", "frame_0005", "frame_0007"]
        there = [frame.file.is_file() for frame in frames]
        assert there == ([True, True, False] if wanted == "1:2" else [True] * 3)
    assert (tmp_path / "asked").read_text().split() == ["0:2", "all"]
    for wrong in ("2:5", "some"):
        with pytest.raises(UserError, match=r"does not name frames of .*scene\.blend, which has 3"):
            convert(scene_file, tmp_path / "out", print, wrong)
    assert not (tmp_path / "out").exists()


def current_umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def test_unknown_formats_and_missing_files(tmp_path):
    with pytest.raises(UserError, match="unknown format"):
        convert(tmp_path / "scene.max", tmp_path / "out", print)
    with pytest.raises(UserError, match="does not exist"):
        convert(Path(tmp_path / "scene.blend"), tmp_path / "out", print)

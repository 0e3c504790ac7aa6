"""Blender as a process: missing, hanging, failing, and files that are not what they seem."""

from __future__ import annotations

import os
import re
import signal
import stat
import subprocess
import sys
import time
from pathlib import Path

import pytest

from gpf.blender import process
from gpf.blender.conversion import RECORD, convert, converted
from gpf.cli import main
from gpf.commands.cameras import file_beside
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
        program(path, 'while [ "$1" != -- ]; do shift; done', "shift", script)
        monkeypatch.setenv(process.VARIABLE, str(path))

    return make


def program(path: Path, *lines: str, version: str = "Blender 5.0.1") -> None:
    """Write a program that tells a version, or runs a script."""
    tell = f'[ "$1" = --version -o "$2" = -c ] && echo {version} && exit'
    path.parent.mkdir(exist_ok=True)
    path.write_text("\n".join(["#!/bin/sh", tell, *lines, ""]))
    path.chmod(path.stat().st_mode | stat.S_IXUSR)


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
CAMERA = {
    **{
        "name": "eye",
        "type": "PERSP",
        "fov": 40,
        "fov_axis": "x",
        "shift": [0, 0],
        "blurred": False,
    },
    **{"clip": [0.1, 100], "matrix": [[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 3], [0, 0, 0, 1]]},
}


@pytest.fixture
def nowhere(tmp_path, monkeypatch):
    """No Blender: a folder for programs, and a Python for it, which is not there."""
    monkeypatch.delenv(process.VARIABLE, raising=False)
    monkeypatch.setenv("PATH", f"{tmp_path / 'path'}:/bin")
    monkeypatch.setattr(process, "installed_python", lambda: tmp_path / "python" / "python")
    return tmp_path / "path" / "blender"


def test_without_blender_the_message_names_the_command(nowhere, scene_file, tmp_path):
    with pytest.raises(UserError, match="gpf blender-install"):
        convert(scene_file, tmp_path / "out", print)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("on_path", "installed", "found"),
    [
        ("Blender 4.5.3 LTS", "", "blender"),
        ("Blender 5.1.0", "Blender 5.0.1", "python"),
        ("Blender 10.0", "no module", "blender"),
        ("Blender 4.4.1", "", r"Blender: must be 4\.5 or later: \S*/path/blender is 4\.4"),
        ("something else", "", "Blender: is not installed"),
    ],
)
def test_the_installed_blender_comes_first_and_old_ones_are_left_out(
    nowhere, on_path, installed, found
):
    program(nowhere, version=on_path)
    if installed:
        program(process.installed_python(), version=installed)
    if ":" in found:
        with pytest.raises(UserError, match=found):
            process.find_blender()
    else:
        assert Path(process.find_blender()[0]).name == found


@pytest.mark.parametrize(
    ("version", "words"),
    [
        (None, "is neither Blender nor a Python with bpy"),
        ("Blender 4.2.0", r"must be 4\.5 or later: \S*mine is 4\.2"),
        ("nothing", "is neither Blender nor a Python with bpy"),
    ],
)
def test_a_variable_that_names_no_blender(scene_file, tmp_path, monkeypatch, version, words):
    if version is not None:
        program(tmp_path / "mine", version=version)
    monkeypatch.setenv(process.VARIABLE, str(tmp_path / "mine"))
    with pytest.raises(UserError, match=f"GPF_BLENDER={tmp_path}/mine: {words}"):
        convert(scene_file, tmp_path / "out", print)


def test_the_reader_runs_below_process_1(tmp_path):
    """As in a container, where the command is process 1."""
    reader = process.PROGRAMS / "read.py"
    lines = [
        "import os, runpy, sys",
        "from unittest.mock import MagicMock",
        "os.getppid = lambda: 1",
        "sys.modules |= {name: MagicMock() for name in ('bpy', 'cameras', 'reader', 'mathutils')}",
        f"sys.argv = ['read.py', '{tmp_path}/scene.obj', '{tmp_path}']",
        f"runpy.run_path('{reader}', run_name='__main__')",
    ]
    (tmp_path / "scene.obj").write_text("v 0 0 0\n")
    done = subprocess.run([sys.executable, "-c", "\n".join(lines)], capture_output=True, text=True)
    assert done.returncode == 0 and "gpf: done" in done.stdout, done.stderr


def test_blender_ends_with_the_process_that_started_it(blender, scene_file, tmp_path):
    blender(f"echo $$ > {tmp_path}/id.new; mv {tmp_path}/id.new {tmp_path}/id; exec sleep 100")
    code = "import sys; from pathlib import Path; from gpf.blender.process import read_with_blender"
    code += f"; read_with_blender(Path('{scene_file}'), Path('{tmp_path}/out'), print)"
    with subprocess.Popen([sys.executable, "-c", code]) as starter:
        while not (tmp_path / "id").exists() and starter.poll() is None:
            time.sleep(0.05)
        starter.kill()
    assert_ends(int((tmp_path / "id").read_text()))


def assert_ends(number: int) -> None:
    try:
        for _ in range(100):
            os.kill(number, 0)
            if "\nState:\tZ" in Path(f"/proc/{number}/status").read_text():
                return
            time.sleep(0.05)
        os.kill(number, signal.SIGKILL)
    except (ProcessLookupError, FileNotFoundError):
        return
    pytest.fail("is still there")


def test_installing_goes_on_with_another_python(nowhere, monkeypatch):
    """Version managers leave commands for Pythons that are not there."""
    monkeypatch.setattr(process.sys, "version_info", (3, 12, 1))
    program(nowhere.with_name("python3.11"), "echo python3.11: not found >&2; exit 127")
    with pytest.raises(UserError, match=r"bpy\S*: could not be installed: python3\.11: not found"):
        process.install(print)
    made = process.installed_python()
    program(made.with_name("made"), f"echo $* >> {made.parent}/ran")
    program(nowhere.with_name("python3.13"), f"cp {made.with_name('made')} {made}")
    assert process.install(print) == made
    assert (made.parent / "ran").read_text().startswith(f"-m pip install --no-compile {NEWER}")


NEWER = process.PACKAGES[3, 13]


def test_the_container_has_a_python_for_blender():
    text = (Path(__file__).parents[2] / "Dockerfile").read_text()
    version = re.search(r"^FROM python:(\d+)\.(\d+)", text, re.MULTILINE)
    assert version and tuple(map(int, version.groups())) in process.PACKAGES


@pytest.mark.parametrize(
    ("script", "words"),
    [
        ("echo gpf-error: is of no use; exit 2", "is of no use. See if Blender opens it; GPF_B"),
        ("echo some last words >&2; exit 11", "exit code 11.*\nsome last words\n. If memory was"),
        ("kill -9 $$", "exit code -9.* If memory was enough, open it in Blender"),
        ("exit 0", "exit code 0"),
        # An exception of our own program is no fault of the file.
        (
            "echo KeyError: 4 >&2; exit 3",
            "KeyError: 4\n. The file may be right: report these words",
        ),
        (
            "echo KeyError: 4 >&2; exit 1",
            "KeyError: 4\n. The file may be right: report these words",
        ),
    ],
)
def test_blender_fails(blender, scene_file, tmp_path, script, words):
    blender(script)
    with pytest.raises(UserError, match=f"(?s){words}"):
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


def test_what_belongs_to_a_file_is_beside_it_and_not_in_the_cache(
    blender, scene_file, tmp_path, monkeypatch, two_threads
):
    """Its cameras, and the image of `gpf mitsuba`."""
    write_json(tmp_path / "found.json", EMPTY | {"lamps": [SUN], "cameras": [CAMERA]})
    blender(f'cp {tmp_path}/found.json "$2/scene.json"')
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    xml, _ = find_scene(str(scene_file))
    in_cache, mine = xml.with_name("views.yaml"), tmp_path / "views.yaml"
    assert file_beside(xml, None) is None
    in_cache.write_text("Blender's")
    assert file_beside(xml, None) == in_cache
    mine.write_text("mine")
    assert file_beside(xml, None) == mine
    assert file_beside(xml, Path("given.yaml")) == Path("given.yaml")
    convert(scene_file, tmp_path / "mine", print)
    assert file_beside(tmp_path / "mine" / "scene.xml", None) is None
    before = {*xml.parent.iterdir()}
    with pytest.raises(SystemExit) as ended:
        main(["mitsuba", str(scene_file), "--spp", "1"])
    assert ended.value.code == 0 and scene_file.with_suffix(".exr").is_file()
    assert {*xml.parent.iterdir()} == before


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

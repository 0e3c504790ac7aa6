"""`gpf fit` and `gpf render`: kills, signals, full disks and a clock that jumps."""

from __future__ import annotations

import os
import random
import shutil
import signal
import subprocess
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import pytest

from gpf.commands.fit import is_finished
from gpf.core.files import read_tensors
from gpf.field.io import load_field
from tests.faults.runner import MOMENTS, SEED, SIGNALS, Ending, Fault, Runner, at_random
from tests.faults.test_disks import small_disk
from tests.faults.wholeness import contents
from tests.stages.conftest import PROJECT, SCENE

FIT = ("fit", "box.xml", "-o", "box.safetensors", "--passes", "12", "--overwrite")
RENDER = ("render", "box.xml", "--field", "old.safetensors", "-o", "pictures", "--orbit", "3")
RENDER = (*RENDER, "--size", "20x16", "--spp", "4", "--mp4", "--aovs", "depth,normal")
COMMANDS = {"fit": FIT, "render": RENDER}
commands = pytest.mark.parametrize("command", COMMANDS)


@dataclass(frozen=True)
class Box:
    """A folder with a scene file and an older field, and what a run without a fault makes in it."""

    folder: Path
    runner: Runner

    def copy(self, folder: Path) -> Path:
        """A copy of the folder."""
        shutil.copytree(self.folder, folder)
        return folder

    def run(self, folder: Path, command: str, fault: Fault | None = None) -> Ending:
        """Run a command."""
        return self.runner.run(folder, *COMMANDS[command], fault=fault, small=True)

    @cached_property
    def well(self) -> dict[str, tuple[Ending, Path]]:
        """Command -> its run without a fault."""
        found = {}
        for command in COMMANDS:
            folder = self.copy(self.folder.with_name(f"well-{command}"))
            found[command] = self.run(folder, command), folder
            assert found[command][0].code == 0, found[command][0].said
        return found

    def survived(self, folder: Path, command: str, ending: Ending) -> None:
        """What a run with a fault left is whole, and the next run finishes; a fit that ended well
        would begin anew."""
        check(folder)
        if command == "render" or ending.code:
            self.finish(folder, command)

    def finish(self, folder: Path, command: str) -> None:
        """The next run makes what one without a fault makes."""
        ending = self.run(folder, command)
        assert ending.code == 0, ending.said
        assert not [p for p in folder.rglob(".*")]
        if command == "render":
            assert contents(folder) == contents(self.well[command][1])
            return
        one, other = (
            read_tensors(f / "box.safetensors", "field")[0] for f in (folder, self.well["fit"][1])
        )
        assert one.keys() == other.keys()
        for name, value in one.items():
            assert value.tobytes() == other[name].tobytes(), name


@pytest.fixture(scope="module")
def box(runner, tmp_path_factory) -> Box:
    folder = tmp_path_factory.mktemp("box") / "box"
    folder.mkdir()
    shutil.copy(PROJECT / "scenes" / SCENE / "scene.xml", folder / "box.xml")
    old = ("fit", "box.xml", "-o", "old.safetensors", "--passes", "6", "--seed", "3")
    ending = runner.run(folder, *old, small=True)
    assert ending.code == 0, ending.said
    shutil.copy(folder / "old.safetensors", folder / "box.safetensors")
    return Box(folder, runner)


def check(folder: Path) -> None:
    """What is there can be read."""
    for path in folder.rglob("*.safetensors"):
        if not path.name.startswith("."):
            read_tensors(path, "fit" if path.stem == "photons" else "field")


@pytest.mark.slow
@pytest.mark.parametrize("number", range(MOMENTS))
@commands
def test_a_killed_command_goes_on(box, tmp_path, command, number):
    folder = box.copy(tmp_path / "box")
    fault = at_random(f"{command} {number}", (signal.SIGKILL,), box.well[command][0])
    ending = box.run(folder, command, fault)
    assert ending.code in (0, -signal.SIGKILL), (SEED, fault, ending.said)
    box.survived(folder, command, ending)


@pytest.mark.slow
@pytest.mark.parametrize("name", SIGNALS)
@commands
def test_a_command_ends_at_a_signal_and_goes_on(box, tmp_path, command, name):
    folder = box.copy(tmp_path / "box")
    fault = at_random(f"{command} {name}", SIGNALS[name], box.well[command][0])
    ending = box.run(folder, command, fault)
    assert "Traceback" not in ending.said, (SEED, fault, ending.said)
    assert ending.code in (0, 1, 130, -SIGNALS[name][0]), (SEED, fault, ending.said)
    box.survived(folder, command, ending)


@pytest.mark.slow
@pytest.mark.parametrize("number", range(MOMENTS))
@commands
def test_files_that_may_not_grow_are_said_in_words(box, tmp_path, command, number):
    folder = box.copy(tmp_path / "box")
    size = random.Random(f"{SEED} {command} size {number}").randrange(100, 200_000)
    ending = box.run(folder, command, Fault(file_size=size))
    assert ending.code == 0 or ending.is_in_words(), (SEED, size, ending.said)
    box.survived(folder, command, ending)


@pytest.mark.slow
@commands
def test_a_full_disk_is_said_in_words(box, tmp_path, command):
    folder = box.copy(tmp_path / "box")
    room = random.Random(f"{SEED} {command} disk").randrange(300_000)
    with small_disk(folder, room):
        ending = box.run(folder, command)
        assert ending.code == 0 or ending.is_in_words(), (SEED, room, ending.said)
        check(folder)
        subprocess.run(["mount", "-o", "remount,size=1g", str(folder)], check=True)
        box.survived(folder, command, ending)


@pytest.mark.slow
@commands
def test_a_read_only_folder_is_said_in_words(box, tmp_path, command):
    folder = box.copy(tmp_path / "box")
    folder.chmod(0o555)
    ending = box.run(folder, command, Fault(unprivileged=True))
    folder.chmod(0o755)
    assert ending.is_in_words(), ending.said
    check(folder)
    box.finish(folder, command)


@pytest.mark.slow
@commands
def test_an_unreadable_scene_is_said_in_words(box, tmp_path, command):
    folder = box.copy(tmp_path / "box")
    (folder / "box.xml").chmod(0)
    ending = box.run(folder, command, Fault(unprivileged=True))
    (folder / "box.xml").chmod(0o644)
    assert ending.is_in_words(), ending.said
    box.finish(folder, command)


@pytest.mark.slow
@pytest.mark.parametrize(("command", "name"), [("fit", "box.fit"), ("render", "pictures")])
def test_a_file_in_place_of_an_output_folder_is_kept(box, tmp_path, command, name):
    folder = box.copy(tmp_path / "box")
    (folder / name).write_text("a file")
    ending = box.run(folder, command)
    assert ending.is_in_words(), ending.said
    assert (folder / name).read_text() == "a file"
    (folder / name).unlink()
    box.finish(folder, command)


@pytest.mark.slow
@commands
def test_a_clock_that_jumps_changes_nothing(box, tmp_path, command):
    folder = box.copy(tmp_path / "box")
    assert box.run(folder, command, Fault(clock=True)).code == 0
    check(folder)


def test_whether_a_fit_is_finished_is_not_told_by_the_clock(box, tmp_path):
    folder = box.copy(tmp_path / "box")
    state, out = folder / "old.fit", folder / "old.safetensors"
    for seconds in (1e9, 4e9):
        os.utime(out, (seconds, seconds))
        assert is_finished(state, out)
    load_field(out)
    next(state.glob("field-*")).unlink()
    assert not is_finished(state, out)

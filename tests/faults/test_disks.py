"""Full disks and files without permission: words, old files or new ones, and the next run ends as
if nothing had happened."""

from __future__ import annotations

import os
import random
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.faults.cases import stages
from tests.faults.runner import MOMENTS, SEED, Fault

pytestmark = pytest.mark.slow

PAGE = 4096
UNPRIVILEGED = Fault(unprivileged=True)


@contextmanager
def small_disk(folder: Path, room: int) -> Iterator[None]:
    """Move a folder to a disk of its own, on which so many bytes are free."""
    away = folder.with_name("away")
    folder.rename(away)
    folder.mkdir()
    sizes = [-(-path.stat().st_size // PAGE) * PAGE for path in away.rglob("*") if path.is_file()]
    options = f"size={sum(sizes) + room // PAGE * PAGE}"
    command = ["mount", "-t", "tmpfs", "-o", options, "none", str(folder)]
    if os.geteuid() or subprocess.run(command, check=False, capture_output=True).returncode:
        pytest.skip("only root can mount a file system with a size limit")
    try:
        shutil.copytree(away, folder, dirs_exist_ok=True)
        yield
    finally:
        subprocess.run(["umount", str(folder)], check=True)


@stages()
def test_a_full_disk_is_said_in_words(trials, tmp_path, stage):
    trial = trials(stage)
    made = trial.before.folder.parent / f"{stage}-well" / "results"
    ending, _ = trial.well
    changed = [p for p in made.rglob("*.*") if p.stat().st_mtime > made.stat().st_ctime - 1]
    most = max(sum(path.stat().st_size for path in changed), 10 * PAGE)
    for number in range(MOMENTS):
        project = trial.before.copy(tmp_path / f"project-{number}")
        room = random.Random(f"{SEED} {stage} disk {number}").randrange(most)
        results = project.folder / "results"
        with small_disk(results, room):
            ending = trial.run(project)
            assert ending.code == 0 or ending.is_in_words(), (SEED, room, ending.said)
            trial.check(project)
            subprocess.run(["mount", "-o", "remount,size=1g", str(results)], check=True)
            trial.finish(project)


@stages(turn=1)
def test_a_read_only_folder_is_said_in_words(trials, tmp_path, stage):
    trial = trials(stage)
    project = trial.before.copy(tmp_path / "project")
    results = project.folder / "results"
    folders = [results, *(path for path in results.rglob("*") if path.is_dir())]
    for folder in folders:
        folder.chmod(0o555)
    try:
        ending = trial.run(project, UNPRIVILEGED)
        assert ending.is_in_words(), ending.said
        trial.check(project)
    finally:
        for folder in folders:
            folder.chmod(0o755)
    trial.finish(project)


@stages(turn=2)
def test_unreadable_settings_are_said_in_words(trials, tmp_path, stage):
    trial = trials(stage)
    project = trial.before.copy(tmp_path / "project")
    file = project.folder / "params.yaml"
    file.chmod(0)
    ending = trial.run(project, UNPRIVILEGED)
    assert ending.is_in_words(), ending.said
    file.chmod(0o644)
    trial.check(project)
    trial.finish(project)

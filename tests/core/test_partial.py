"""What killed runs leave is removed; what is being written, and what is complete, stays."""

from __future__ import annotations

import subprocess
import sys

import pytest

from gpf.core import partial
from gpf.core.files import write_text
from gpf.core.partial import partial_file, partial_folder, remove_leftovers, replace_folder

KILLED = """
import os, signal, sys
from pathlib import Path
from gpf.core.partial import partial_file, partial_folder
with partial_file(Path(sys.argv[1], "table.csv")), partial_folder(Path(sys.argv[1], "scene")):
    os.kill(os.getpid(), signal.SIGKILL)
"""


def names(folder) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_what_a_killed_run_leaves_is_removed(tmp_path):
    subprocess.run([sys.executable, "-c", KILLED, str(tmp_path)], check=False)
    assert len(names(tmp_path)) == 2
    write_text(tmp_path / "table.csv", "whole")
    remove_leftovers(tmp_path)
    assert names(tmp_path) == ["table.csv"]


def test_what_is_being_written_stays(tmp_path):
    below = tmp_path / "below"
    below.mkdir()
    (below / ".gpf-partial-old").write_text("half")
    with partial_file(below / "table.csv") as file, partial_folder(below / "scene") as folder:
        remove_leftovers(tmp_path)
        assert (below / ".gpf-partial-old").exists()
        remove_leftovers(tmp_path, deep=True)
        assert names(below) == sorted([file.name, folder.name])
    assert names(below) == []


@pytest.mark.parametrize(
    ("make", "partial_one"), [("mkstemp", partial_file), ("mkdtemp", partial_folder)]
)
def test_what_is_about_to_be_locked_may_be_taken_for_a_leftover(
    tmp_path, monkeypatch, make, partial_one
):
    """By another run, between the two calls; then a new one is made."""
    plain, made = getattr(partial.tempfile, make), []

    def slow(*where, **named):
        made.append(plain(*where, **named))
        if len(made) == 1:
            remove_leftovers(tmp_path)
            assert names(tmp_path) == []
        return made[-1]

    monkeypatch.setattr(partial.tempfile, make, slow)
    with partial_one(tmp_path / "table.csv") as path:
        assert path.exists() and len(made) == 2
        path.rename(tmp_path / "table.csv")
    assert names(tmp_path) == ["table.csv"]


def test_the_old_folder_is_removed_after_the_new_one_has_its_place(tmp_path, monkeypatch):
    def stop(path, **more):
        raise KeyboardInterrupt

    for name in ("new", "old"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "of").write_text(name)
    monkeypatch.setattr(partial.shutil, "rmtree", stop)
    with pytest.raises(KeyboardInterrupt):
        replace_folder(tmp_path / "new", tmp_path / "old")
    assert (tmp_path / "old" / "of").read_text() == "new"


@pytest.mark.parametrize("at_once", [True, False])
def test_a_folder_takes_the_place_of_another(tmp_path, monkeypatch, at_once):
    if not at_once:  # as on a file system that cannot exchange folders
        monkeypatch.setattr(partial, "_RENAME_EXCHANGE", 1 << 30)
    for name, text in (("new", "a"), ("old", "b")):
        (tmp_path / name).mkdir()
        (tmp_path / name / text).write_text(text)
    replace_folder(tmp_path / "new", tmp_path / "old")
    assert names(tmp_path) == ["old"] and names(tmp_path / "old") == ["a"]
    replace_folder(tmp_path / "old", tmp_path / "other")
    assert names(tmp_path) == ["other"]

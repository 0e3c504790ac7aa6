"""Files that belong together appear together, also after a kill at any moment."""

from __future__ import annotations

import os

import pytest

from gpf.core.errors import UserError
from stages.common.publishing import prepare_files, publish_files


def write(folder):
    (folder / "images").mkdir()
    for name in ("a", "images/b", "images/c"):
        (folder / name).write_text(name)


def files(folder):
    return {
        p.relative_to(folder).as_posix(): p.read_text() for p in folder.rglob("*") if p.is_file()
    }


ALL = {"a": "a", "images/b": "images/b", "images/c": "images/c"}


def test_all_files_find_their_places(tmp_path):
    target = tmp_path / "results"
    (target / "images").mkdir(parents=True)
    (target / "images/b").write_text("old")
    (target / "other").write_text("other")
    prepare_files(tmp_path / "parts" / "work", write)
    assert files(target) == {"images/b": "old", "other": "other"}
    publish_files(tmp_path / "parts" / "work", target)
    assert files(target) == ALL | {"other": "other"}
    assert not (tmp_path / "parts").exists()


def test_nothing_appears_of_what_could_not_be_written(tmp_path):
    def fail(folder):
        write(folder)
        raise OSError("full")

    with pytest.raises(OSError, match="full"):
        prepare_files(tmp_path / "work", fail)
    publish_files(tmp_path / "work", tmp_path / "results")
    assert files(tmp_path) == {}


@pytest.mark.parametrize("moves", [0, 1, 2])
def test_a_kill_while_files_are_moved(tmp_path, monkeypatch, moves):
    target, done = tmp_path / "results", []
    prepare_files(tmp_path / "work", write)
    replace = os.replace

    def killed(source, place):
        if len(done) == moves:
            raise KeyboardInterrupt
        done.append(place)
        replace(source, place)

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", killed)
        with pytest.raises(KeyboardInterrupt):
            publish_files(tmp_path / "work", target)
    assert len(files(target)) == moves if target.exists() else moves == 0
    publish_files(tmp_path / "work", target)
    assert files(target) == ALL and not (tmp_path / "work").exists()


def test_what_a_kill_left_half_written_is_forgotten(tmp_path):
    begun = tmp_path / "work" / "begun"
    begun.mkdir(parents=True)
    (begun / "half").write_text("half")
    publish_files(tmp_path / "work", tmp_path / "results")
    prepare_files(tmp_path / "work", write)
    publish_files(tmp_path / "work", tmp_path / "results")
    assert files(tmp_path / "results") == ALL


def test_a_folder_that_cannot_be_made_is_said_in_words(tmp_path):
    (tmp_path / "work").write_text("a file in its place")
    with pytest.raises(UserError, match=r"work/begun: could not be written .*Free some disk space"):
        prepare_files(tmp_path / "work", write)
    assert files(tmp_path) == {"work": "a file in its place"}


def test_what_a_killed_run_did_not_remove_goes(tmp_path):
    """It was killed while it removed the parts of which the prepared files were made."""
    work, target = tmp_path / "parts" / "work", tmp_path / "results"
    prepare_files(work, lambda folder: (folder / "a.txt").write_text("new"))
    (work / "0-1.safetensors").write_text("part")
    publish_files(work, target)
    assert (target / "a.txt").read_text() == "new"
    assert not work.parent.exists()

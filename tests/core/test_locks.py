"""One run for each output; the second one is told who holds it."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from gpf.core.errors import UserError
from gpf.core.locks import sole_run

HOLDER = """
import sys, time
from pathlib import Path
from gpf.core.locks import sole_run
with sole_run(Path(sys.argv[1])):
    print("holds", flush=True)
    time.sleep(100)
"""


@pytest.fixture
def output(tmp_path):
    return tmp_path / "results" / "train"


def test_the_second_is_told_who_is_at_work(output):
    holder = re.escape(f"process {os.getpid()} on {socket.gethostname()} since ")
    words = rf"results/train: is being made by {holder}\d{{4}}-.*\. Wait until it finishes"
    with sole_run(output):
        with pytest.raises(UserError, match=words), sole_run(output):
            pass
        with sole_run(output.with_name("render")):
            pass
    with sole_run(output):
        pass
    assert list(output.parent.iterdir()) == []


def test_the_lock_of_a_folder_lies_in_it(tmp_path, monkeypatch):
    folder = tmp_path / "pictures"
    with sole_run(folder, inside=True):
        assert [path.name for path in tmp_path.rglob("*")] == ["pictures", ".lock-run"]
        monkeypatch.chdir(folder)
        with pytest.raises(UserError, match="is being made"), sole_run(Path("."), inside=True):
            pass
    assert list(folder.iterdir()) == []


def test_shared_runs_work_side_by_side_but_not_beside_another(output):
    with sole_run(output, shared=True):
        with sole_run(output, shared=True):
            pass
        assert len(list(output.parent.iterdir())) == 1
        with pytest.raises(UserError, match="is being made by process"), sole_run(output):
            pass
    with sole_run(output):
        pass


def test_a_killed_run_blocks_nobody(output):
    command = [sys.executable, "-c", HOLDER, str(output)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout.readline() == "holds\n"
        with pytest.raises(UserError, match=f"process {holder.pid} on"), sole_run(output):
            pass
        holder.send_signal(signal.SIGKILL)
    assert len(list(output.parent.iterdir())) == 1
    with sole_run(output):
        pass
    assert list(output.parent.iterdir()) == []


def test_a_folder_that_cannot_be_written(tmp_path):
    (tmp_path / "results").write_text("a file")
    words = r"\.lock-train: could not be written .*check the folder"
    with pytest.raises(UserError, match=words), sole_run(tmp_path / "results" / "train"):
        pass

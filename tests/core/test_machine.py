"""The description of the machine and its software, with and without a git repository."""

import json
import subprocess
from pathlib import Path

import drjit as dr
import mitsuba as mi
import pytest

from gpf.core import machine
from gpf.core.machine import device_description, read_commit, read_version


def test_the_description_is_plain_and_complete() -> None:
    description = device_description()
    assert json.loads(json.dumps(description)) == description
    assert set(description) == {
        *("cpu", "cores", "gpu", "variant", "llvm", "python", "packages", "commit")
    }
    assert description["variant"] == mi.variant()
    assert description["packages"]["mitsuba"] == mi.__version__
    assert description["cores"] >= 1


def test_a_copy_inside_another_repository_has_no_commit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def git(*arguments: str) -> None:
        identity = ("-c", "user.name=a", "-c", "user.email=a@example.org")
        subprocess.run(["git", "-C", tmp_path, *identity, *arguments], check=True)

    git("init", "--quiet")
    git("commit", "--quiet", "--allow-empty", "--message", "one")
    monkeypatch.setattr(machine, "__file__", str(tmp_path / "gpf" / "core" / "machine.py"))
    assert len(read_commit() or "") == 40
    (tmp_path / "venv" / "gpf").mkdir(parents=True)
    monkeypatch.setattr(machine, "__file__", str(tmp_path / "venv" / "gpf" / "core" / "machine.py"))
    assert read_commit() is None


def test_a_package_that_is_absent_has_no_version() -> None:
    assert read_version("gpf-test-llvm") is None
    assert read_version("drjit") == dr.__version__

"""Skipped tests fail in CI, unless tests/skips.py has the reason."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

PROJECT = Path(__file__).parent.parent.parent
TESTS = """
import pytest

@pytest.mark.skipif(True, reason="half precision on CUDA")
def test_marked(): pass

def test_inside(): pytest.skip("not today")

@pytest.mark.xfail(reason="known")
def test_known(): assert False

def test_good(): pass
"""
WHOLE_FILE = "import pytest\npytest.skip('no such package', allow_module_level=True)\n"


@pytest.mark.parametrize(
    ("ci", "workers", "outcome"),
    [
        ("", "0", "1 passed, 3 skipped, 1 xfailed"),
        ("true", "0", "1 failed, 1 passed, 1 skipped, 1 xfailed, 1 error"),
        ("true", "2", "1 failed, 1 passed, 1 skipped, 1 xfailed, 1 error"),
    ],
)
def test_a_skip_fails_in_ci_unless_it_is_on_the_list(tmp_path, ci, workers, outcome):
    folder = tmp_path / "tests" / "baselines"
    folder.mkdir(parents=True)
    (folder / "test_hash_encoding.py").write_text(TESTS)
    (folder / "test_whole.py").write_text(WHOLE_FILE)
    (tmp_path / "pytest.ini").write_text("[pytest]\n")
    options = ["-p", "tests.skips", "-n", workers, "--continue-on-collection-errors"]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *options, "tests"],
        cwd=tmp_path,
        env={**os.environ, "CI": ci, "PYTHONPATH": str(PROJECT)},
        capture_output=True,
        text=True,
    )
    assert outcome in done.stdout.splitlines()[-1], done.stdout + done.stderr
    assert ("In CI nothing is skipped" in done.stdout) == bool(ci)
    assert "SKIPPED [1] half precision on CUDA" in done.stdout
    assert ("SKIPPED [1] not today" in done.stdout) == (not ci)
    assert done.returncode == (1 if ci else 0)

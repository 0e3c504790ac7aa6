"""The process of a fit ends with the viewer that started it."""

from __future__ import annotations

import subprocess
import sys

import pytest

FIT = """
import os, sys, time
from gpf.viewing import background_fit
sys.platform = sys.argv[1]
background_fit._end_with(os.getppid())
print("fitting", flush=True)
time.sleep(20)
print("left over", flush=True)
"""
VIEWER = "import subprocess, sys; subprocess.run([sys.executable, '-c', *sys.argv[1:]])"


@pytest.mark.parametrize("system", ["linux", "darwin"])
def test_the_fit_of_a_killed_viewer_ends(system):
    command = [sys.executable, "-c", VIEWER, FIT, system]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as viewer:
        assert viewer.stdout is not None and viewer.stdout.readline() == "fitting\n"
        viewer.kill()
        assert viewer.stdout.read() == ""

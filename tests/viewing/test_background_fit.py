"""The process of a fit ends with the viewer that started it."""

from __future__ import annotations

import subprocess
import sys

import pytest

from gpf.viewing.background_fit import BackgroundFit

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


WARNS = """<scene version="3.0.0"><sensor type="orthographic">
<film type="hdrfilm"><boolean name="compensate" value="true"/></film></sensor></scene>"""


def test_warnings_of_mitsuba_do_not_end_the_link(tmp_path):
    """It prints them where the fit reports; that the fit then fails is told."""
    scene = tmp_path / "scene.xml"
    scene.write_text(WARNS)
    fit = BackgroundFit(scene, tmp_path / "field.safetensors", None, tmp_path)
    fit._thread.join(60)
    assert fit.status.ended and fit.status.error.startswith(f"{scene}: has no emitters")
    assert not fit.close()

"""`gpf view` whose fit runs: kills and signals leave whole files, and the next start goes on."""

from __future__ import annotations

import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from gpf.core.files import read_tensors
from gpf.field.io import load_field
from tests.faults.runner import ENVIRONMENT, SEED
from tests.faults.wholeness import read_any
from tests.stages.conftest import PROJECT, SCENE

pytestmark = pytest.mark.slow

# Python imports it at its start: the process of the fit is one of its own.
SMALL = """
import sys
if "gpf.viewing.background_fit" in sys.orig_argv:
    import pytest
    from tests.small_fit import make_small
    make_small(pytest.MonkeyPatch(), passes=4, steps=20, paths=5_000)
"""
# It hears Ctrl-C even where the tests run in the background, which do not.
VIEW = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)
from gpf.cli import main
main(["view", "box.xml", "--no-open", "-o", "box.safetensors"])
"""


@pytest.fixture(scope="module")
def environment(tmp_path_factory) -> dict[str, str]:
    folder = tmp_path_factory.mktemp("small")
    (folder / "sitecustomize.py").write_text(SMALL)
    return {**ENVIRONMENT, "PYTHONPATH": os.pathsep.join([str(folder), str(PROJECT)])}


@pytest.fixture
def folder(tmp_path) -> Path:
    shutil.copy(PROJECT / "scenes" / SCENE / "scene.xml", tmp_path / "box.xml")
    return tmp_path


@contextmanager
def viewing(folder: Path, environment: dict[str, str]) -> Iterator[subprocess.Popen[str]]:
    """`gpf view` that fits; what it says goes to log.txt."""
    with (folder / "log.txt").open("w") as log:
        process = subprocess.Popen(
            [sys.executable, "-c", VIEW], cwd=folder, env=environment, stdout=log, stderr=log
        )
        try:
            yield process
        finally:
            process.kill()
            process.wait()


def passes(folder: Path) -> int:
    """Of the saved state, which has to be whole; 0 without one."""
    file = folder / "box.fit" / "photons.safetensors"
    return read_tensors(file, "fit")[1]["facts"]["passes"] if file.exists() else 0


def wait_for_more(folder: Path, process: subprocess.Popen[str], before: int = 0) -> int:
    """Wait until the saved state has a field of more passes; their number."""
    deadline = time.monotonic() + 90
    while (found := passes(folder)) <= before:
        said = (folder / "log.txt").read_text()
        assert process.poll() is None and time.monotonic() < deadline, said
        time.sleep(0.05)
    return found


def fit_of(viewer: int) -> int:
    """The process of the fit."""
    import psutil

    children = psutil.Process(viewer).children(recursive=True)
    return next(c.pid for c in children if "gpf.viewing.background_fit" in c.cmdline())


def wait_for_end(process: int) -> None:
    """The fit has to end with the viewer, and soon."""
    import psutil

    deadline = time.monotonic() + 10
    while psutil.pid_exists(process):
        assert time.monotonic() < deadline
        time.sleep(0.05)


def check(folder: Path) -> None:
    """What is there is whole."""
    for file in folder.rglob("*.safetensors"):
        if not file.name.startswith("."):
            read_any(file)


FAULTS = {
    "SIGKILL": (signal.SIGKILL,),
    "SIGTERM": (signal.SIGTERM,),
    "SIGHUP": (signal.SIGHUP,),
    "Ctrl-C": (signal.SIGINT,),
    "Ctrl-C twice": (signal.SIGINT, signal.SIGINT),
    "SIGTERM twice": (signal.SIGTERM, signal.SIGTERM),
}


# The stages have every signal; here, one that can be heard and one that cannot.
@pytest.mark.parametrize(
    "name",
    [
        name if name in ("SIGKILL", "Ctrl-C") else pytest.param(name, marks=pytest.mark.long)
        for name in FAULTS
    ],
)
def test_a_signal_keeps_the_field_and_the_next_start_goes_on(folder, environment, name):
    chance = random.Random(f"{SEED} view {name}")
    with viewing(folder, environment) as process:
        before, fit = wait_for_more(folder, process), fit_of(process.pid)
        time.sleep(chance.uniform(0, 2))
        for signum in FAULTS[name]:
            process.send_signal(signum)
            time.sleep(chance.uniform(0, 0.05))
        code = process.wait(timeout=30)
    said = (folder / "log.txt").read_text()
    assert "Traceback" not in said, said
    wait_for_end(fit)
    check(folder)
    before = max(before, passes(folder))
    if name == "SIGKILL":
        assert code == -signal.SIGKILL and not (folder / "box.safetensors").exists()
    else:
        assert code in (0, -FAULTS[name][-1]), said  # the second may come at the very end
        assert load_field(folder / "box.safetensors").record["passes"] >= before
        (folder / "box.safetensors").unlink()
    with viewing(folder, environment) as process:
        assert wait_for_more(folder, process, before) > before
        assert not list(folder.glob(".gpf-partial-*"))
        process.send_signal(signal.SIGTERM)
        assert process.wait(timeout=30) == 0
    said = (folder / "log.txt").read_text()
    kept = re.search(r"box.safetensors: field after (\d+) passes", said)
    assert kept is not None and int(kept[1]) > before, said


def test_only_the_fit_is_killed(folder, environment):
    """As a system without memory left does."""
    with viewing(folder, environment) as process:
        deadline = time.monotonic() + 90
        while "Ctrl-C to stop" not in (folder / "log.txt").read_text():
            assert process.poll() is None and time.monotonic() < deadline
            time.sleep(0.05)
        fit = fit_of(process.pid)
        os.kill(fit, signal.SIGKILL)
        wait_for_end(fit)
        process.send_signal(signal.SIGTERM)
        assert process.wait(timeout=30) == 0
    said = (folder / "log.txt").read_text()
    assert "Traceback" not in said
    assert "No field. SIGKILL ended it, perhaps for lack of memory" in said


def test_a_material_that_cannot_be_traced(folder, environment):
    """The fit says so in words, and the viewer repeats them when it ends."""
    text = (folder / "box.xml").read_text()
    bump = '<bsdf type="bumpmap"><texture type="checkerboard"/><bsdf type="diffuse"/></bsdf>'
    shape = f'<shape type="sphere">{bump}</shape></scene>'
    (folder / "box.xml").write_text(text.replace("</scene>", shape))
    with viewing(folder, environment) as process:
        deadline = time.monotonic() + 90
        while "Ctrl-C to stop" not in (folder / "log.txt").read_text():
            assert process.poll() is None and time.monotonic() < deadline
            time.sleep(0.05)
        wait_for_end(fit_of(process.pid))
        process.send_signal(signal.SIGTERM)
        assert process.wait(timeout=30) == 0
    said = " ".join((folder / "log.txt").read_text().split())
    assert "Traceback" not in said
    assert re.search(r"No field\. .*cannot be traced: .* Give the bumpmap", said), said

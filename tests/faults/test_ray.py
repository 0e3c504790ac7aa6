"""A Ray cluster whose node or head is killed: what is done is kept, and the next run goes on."""

from __future__ import annotations

import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest

from gpf.field.io import save_field
from gpf.scene.fingerprint import fingerprint
from gpf.scene.load import load_scene_file
from tests.commands.box import box_field
from tests.faults.runner import ENVIRONMENT
from tests.faults.wholeness import assert_old_or_new, contents
from tests.stages.conftest import PROJECT, SCENE, new_project

pytestmark = pytest.mark.slow

KILLED = {"a node": ("raylet",), "the head": ("gcs_server", "raylet")}
NO_HEAD = "the head of the Ray cluster, "
WHAT_THEN = ": no longer answers. Restart the cluster, then run this again"
RAYS_OWN_WORDS = "Failed to connect to GCS within 60 seconds. GCS may have been killed."
"""Of a head that dies between our question whether it lives and the call that needs it: Ray waits
for a minute and ends the process, before Python can say anything."""


def run_and_kill(
    process: subprocess.Popen[str], names: tuple[str, ...], begun: Callable[[], bool]
) -> str:
    """Kill programs of the cluster that a process has started as soon as it has made something;
    what the process says until it ends."""
    import psutil

    pytest.importorskip("ray")
    killed: set[str] = set()
    with process:
        deadline = time.monotonic() + 120
        while process.poll() is None and not killed and time.monotonic() < deadline:
            if begun():
                for child in psutil.Process(process.pid).children(recursive=True):
                    with suppress(psutil.NoSuchProcess):
                        if (name := child.name()) in names:
                            child.kill()
                            killed.add(name)
            time.sleep(0.01)
        try:
            output, _ = process.communicate(timeout=120)
        finally:
            process.kill()
    assert killed == set(names), output
    return output


def check_words(process: subprocess.Popen[str], output: str, what: str) -> None:
    """An end in words. Without its cluster, Ray may make the exit code 1 when it is shut down."""
    assert process.returncode in (0, 1, 2) and "Traceback" not in output, output
    if what == "the head" and RAYS_OWN_WORDS in output:
        assert process.returncode == 1, output
        return
    assert process.returncode == 0 or "error: " in output, output
    if what == "the head":
        assert process.returncode and NO_HEAD in output and WHAT_THEN in output, output


@pytest.mark.parametrize("what", ["a node", pytest.param("the head", marks=pytest.mark.long)])
def test_passes_go_on_after_a_machine_is_lost(tmp_path, what):
    project = new_project(tmp_path / "project")
    project.edit("params.yaml", reference__passes=40, reference__photons_per_pass=50_000)
    assert project.stage("scene").code == 0
    before = contents(project.folder / "results")
    local = project.copy(tmp_path / "local")
    assert local.stage("reference").code == 0
    project.edit("params.yaml", executor="ray", cluster__passes_per_task=4)
    process = project.start("reference", ENVIRONMENT)
    parts = "checkpoints/*/*/[0-9]*.safetensors"
    output = run_and_kill(process, KILLED[what], lambda: any(project.results.rglob(parts)))
    check_words(process, output, what)
    wanted = contents(local.folder / "results")
    assert_old_or_new(project.folder / "results", before, wanted)
    project.edit("params.yaml", executor="local")
    assert project.stage("reference").code == 0
    assert contents(project.folder / "results") == wanted


@pytest.mark.parametrize("what", [pytest.param("a node", marks=pytest.mark.long), "the head"])
def test_pictures_go_on_after_a_machine_is_lost(tmp_path, what):
    shutil.copy(PROJECT / "scenes" / SCENE / "scene.xml", tmp_path / "box.xml")
    scene = load_scene_file(tmp_path / "box.xml")
    field = box_field(scene)
    field.record = {"fingerprint": fingerprint(scene), "exposure": 1.5}
    save_field(field, tmp_path / "field.safetensors")

    def start(*more: str) -> subprocess.Popen[str]:
        words = ("box.xml", "--orbit", "6", "--size", "96", "--spp", "256", *more)
        return subprocess.Popen(
            [sys.executable, "-m", "gpf.cli", "render", *words],
            cwd=tmp_path,
            env=ENVIRONMENT,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )

    def pictures(folder: str) -> dict[str, bytes]:
        return {path.name: path.read_bytes() for path in Path(tmp_path / folder).glob("*.*")}

    process = start("-o", "some", "--executor", "ray")
    output = run_and_kill(process, KILLED[what], lambda: any((tmp_path / "some").glob("*.exr")))
    check_words(process, output, what)
    kept = {path: path.stat().st_mtime_ns for path in (tmp_path / "some").glob("*.exr")}
    assert kept
    for folder in ("some", "all"):
        with start("-o", folder) as process:
            output, _ = process.communicate(timeout=200)
        assert process.returncode == 0, output
    assert pictures("some") == pictures("all")
    assert {path: path.stat().st_mtime_ns for path in kept} == kept

"""Passes on a Ray cluster: the bits of one machine, also when a worker dies."""

from __future__ import annotations

import io
import os
import sys
import time
import zipfile
from contextlib import chdir

import pytest

from stages.common.workspace import Workspace
from stages.references.cluster import pack


def test_what_travels_is_enough_and_no_more(built):
    os.utime(built.folder / "results/cornell_box/views.yaml", (0, 0))  # some systems give no dates
    with chdir(built.folder):
        names = set(zipfile.ZipFile(io.BytesIO(pack(Workspace.open("cornell_box")))).namelist())
    assert names == {
        "params.yaml",
        "scenes/cornell_box/scene.xml",
        "scenes/cornell_box/views.yaml",
        "results/cornell_box/views.yaml",
        "results/cornell_box/scene/",
        "results/cornell_box/scene/scene.xml",
    } - ({"results/cornell_box/scene/"} - names)


def test_without_ray(fresh, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    fresh.edit("params.yaml", executor="ray")
    assert fresh.stage("scene").code == 0
    outcome = fresh.stage("reference")
    assert outcome.code == 2 and "Traceback" not in outcome.text
    assert "executor: is ray, but the ray package is not installed. Install it" in outcome.text


def workers(driver: int) -> list:
    """Processes that are rendering passes, of the cluster that a process has started."""
    import psutil

    descendants = psutil.Process(driver).children(recursive=True)
    return [p for p in descendants if "ray::render_part" in _title(p)]


def _title(process) -> str:
    import psutil

    try:
        return " ".join(process.cmdline())
    except psutil.NoSuchProcess:
        return ""


@pytest.mark.slow
def test_two_workers_one_of_which_is_killed(fresh, environment):
    pytest.importorskip("ray")
    assert fresh.stage("scene").code == 0
    fresh.edit("params.yaml", reference__passes=60, reference__photons_per_pass=50_000)
    local = fresh.copy(fresh.folder.parent / "local")
    assert local.stage("reference").code == 0

    fresh.edit("params.yaml", executor="ray", cluster__passes_per_task=5)
    killed = False
    with fresh.start("reference", environment()) as process:
        kept = fresh.results / "checkpoints"
        deadline = time.monotonic() + 120
        while process.poll() is None and not killed and time.monotonic() < deadline:
            if any(kept.rglob("[0-9]*.safetensors")) and (busy := workers(process.pid)):
                busy[0].kill()
                killed = True
            time.sleep(0.01)
        output, _ = process.communicate(timeout=200)
    assert killed and process.returncode == 0, output
    made = sorted(p.relative_to(local.results) for p in local.results.glob("*/*.exr"))
    assert len(made) == 3 + 2 * 4
    for path in made:
        assert (fresh.results / path).read_bytes() == (local.results / path).read_bytes(), path
    assert not kept.exists()


@pytest.mark.slow
def test_a_cluster_that_is_not_there(fresh):
    pytest.importorskip("ray")
    fresh.edit("params.yaml", executor="ray", cluster__address="127.0.0.1:1")
    assert fresh.stage("scene").code == 0
    outcome = fresh.stage("reference")
    assert outcome.code == 2 and "Traceback" not in outcome.text
    assert "cluster.address: '127.0.0.1:1': cannot be reached" in outcome.text

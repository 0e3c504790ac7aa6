"""Two runs for the same output at once: the second says who is at work, and changes nothing."""

from __future__ import annotations

import os
import re
import shutil
import time

import pytest

from gpf.core.locks import sole_run
from gpf.field.io import save_field
from gpf.scene.fingerprint import fingerprint
from gpf.scene.load import load_scene_file
from tests.commands.box import box_field
from tests.faults.cases import CASES
from tests.faults.runner import ENVIRONMENT
from tests.stages.conftest import PROJECT, SCENE, new_project


@pytest.fixture
def project(tmp_path):
    return new_project(tmp_path / "project")


def assert_busy(outcome, output: str, process: int) -> None:
    assert outcome.code == 2 and "Traceback" not in outcome.text
    words = rf"{re.escape(output)}: is being made by process {process} on \S+ since \d{{4}}-"
    assert re.search(words, outcome.text), outcome.text


@pytest.mark.parametrize("stage", CASES)
def test_a_stage_that_runs_already(project, stage):
    case, place = CASES[stage], "results" if stage == "report" else f"results/{SCENE}"
    output = f"{place}/" + "-".join([stage, *case.options[1:]])
    with sole_run(project.folder / output):
        before = project.snapshot()
        assert_busy(project.gpf(*case.arguments), output, os.getpid())
        assert project.snapshot() == before


def test_a_fit_that_runs_already(project):
    shutil.copy(PROJECT / "scenes" / SCENE / "scene.xml", project.folder / "box.xml")
    with sole_run(project.folder / "box.safetensors"):
        outcome = project.gpf("fit", "box.xml", "-o", "box.safetensors", "--passes", "2")
    assert_busy(outcome, "box.safetensors", os.getpid())
    assert not (project.folder / "box.fit").exists()


def test_a_viewer_that_fits_already(project):
    shutil.copy(PROJECT / "scenes" / SCENE / "scene.xml", project.folder / "box.xml")
    with sole_run(project.folder / "box.safetensors"):
        outcome = project.gpf("view", "box.xml", "-o", "box.safetensors", "--no-open")
    assert_busy(outcome, "box.safetensors", os.getpid())


def test_pictures_that_are_being_made(project):
    shutil.copy(PROJECT / "scenes" / SCENE / "scene.xml", project.folder / "box.xml")
    scene = load_scene_file(project.folder / "box.xml")
    field = box_field(scene)
    field.record = {"fingerprint": fingerprint(scene)}
    save_field(field, project.folder / "field.safetensors")
    with sole_run(project.folder / "pictures", inside=True):
        outcome = project.gpf("render", "box.xml", "--size", "8x8", "--spp", "1")
    assert_busy(outcome, "pictures", os.getpid())
    assert not list((project.folder / "pictures").iterdir())


@pytest.mark.slow
def test_two_processes_at_once(project):
    project.edit("params.yaml", reference__passes=100_000, progress__checkpoint_seconds=0.01)
    assert project.stage("scene").code == 0
    with project.start("reference", ENVIRONMENT) as first:
        deadline = time.monotonic() + 90
        while not list(project.results.glob("checkpoints/*/*/*")) and time.monotonic() < deadline:
            time.sleep(0.05)
        try:
            outcome = project.stage("reference")
        finally:
            first.kill()
    assert_busy(outcome, f"results/{SCENE}/reference", first.pid)
    project.edit("params.yaml", reference__passes=4)
    assert project.stage("reference").code == 0
    assert not list(project.results.glob(".*"))

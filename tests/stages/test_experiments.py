"""`dvc exp run` in a copy of the project: it runs the copy's code, as the experiment records."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from ruamel.yaml import YAML

from tests.stages.conftest import Project
from tests.stages.imports import PROJECT
from tests.stages.pipeline import Checkout, add_pipeline

pytest.importorskip("dvc")
pytestmark = pytest.mark.slow


@pytest.fixture
def checkout(fresh, environment, tmp_path) -> Checkout:
    """A checkout with the first stage alone, while `gpf` is installed from elsewhere: from this
    repository."""
    add_pipeline(fresh)
    keep_first_stage(fresh.folder / "dvc.yaml")
    made = Checkout.at(fresh, tmp_path / "bin", environment())
    made.commit()
    return replace(made, variables={**made.variables, "PYTHONPATH": str(PROJECT)})


def keep_first_stage(file: Path) -> None:
    """Remove the other stages."""
    yaml = YAML()
    pipeline = yaml.load(file.read_text(encoding="utf-8"))
    pipeline["stages"] = {"scene": pipeline["stages"]["scene"]}
    with file.open("w", encoding="utf-8") as stream:
        yaml.dump(pipeline, stream)


def note(project: Project, text: str) -> None:
    """Change the code of the stage: it writes the text into the list of the scene's contents."""
    file = project.folder / "stages/scene.py"
    original = (PROJECT / "stages/scene.py").read_text(encoding="utf-8")
    written = f'{{**scene_info(scene), "note": {text!r}}}' if text else "scene_info(scene)"
    changed = original.replace('scene.json", scene_info(scene)', f'scene.json", {written}')
    assert changed != original or not text
    file.write_text(changed, encoding="utf-8")


def noted(checkout: Checkout) -> str | None:
    """What the run of the stage has written whose results are there."""
    facts = json.loads((checkout.project.results / "scene.json").read_text(encoding="utf-8"))
    return facts.get("note")


def test_the_code_of_the_workspace_runs(checkout):
    note(checkout.project, "workspace")
    checkout.dvc("repro")
    assert noted(checkout) == "workspace"
    assert "up to date" in checkout.dvc("repro")
    assert "up to date" in checkout.dvc("status")


@pytest.mark.parametrize("way", ["--temp", "--queue"])
def test_the_code_of_the_experiments_copy_runs(checkout, way):
    note(checkout.project, "tried")
    checkout.dvc("exp", "run", way, "--name", "tried")
    note(checkout.project, "")
    if way == "--queue":  # the workspace has gone on when it runs
        checkout.dvc("exp", "run", "--run-all")
    assert not (checkout.project.results / "scene.json").exists()
    checkout.dvc("exp", "apply", "tried")
    assert noted(checkout) == "tried"
    assert "up to date" in checkout.dvc("status")

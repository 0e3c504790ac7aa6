"""Projects in temporary folders, and the command line run in them."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import chdir, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ruamel.yaml import YAML

from gpf.cli import main
from stages.commands.profiles import apply_profile
from stages.commands.stage import OF_ALL_SCENES
from tests.made_once import made_once
from tests.stages.results import SMOKE_STAGES

PROJECT = Path(__file__).parent.parent.parent
SCENE = "cornell_box"
# Of stages that run several rows of params.yaml: the options for each.
ROWS = {
    "baseline": [("--method", "path_10")],
    "ablation": [("--variant", "init_radius"), ("--variant", "all")],
}


HEARING = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)
from gpf.cli import main
main()
"""


@dataclass(frozen=True)
class Outcome:
    """How a call of the command line ended, and what it said."""

    code: int
    text: str


@dataclass(frozen=True)
class Project:
    """A folder with params.yaml and scenes/, and what has been made in it."""

    folder: Path

    @property
    def results(self) -> Path:
        """What the stages wrote for the scene."""
        return self.folder / "results" / SCENE

    def gpf(self, *arguments: str) -> Outcome:
        """Run the command line in this folder; any other exception than SystemExit comes out."""
        text = StringIO()
        with (
            chdir(self.folder),
            redirect_stdout(text),
            redirect_stderr(text),
            pytest.raises(SystemExit) as caught,
        ):
            main(arguments)
        return Outcome(int(caught.value.code or 0), " ".join(text.getvalue().split()))

    def stage(self, name: str, scene: str = SCENE, more: Sequence[str] = ()) -> Outcome:
        """Run one stage; ``more``: further options."""
        of_scene = [] if name in OF_ALL_SCENES else ["--scene", scene]
        return self.gpf("stage", name, *of_scene, *more)

    def run(self, *names: str) -> None:
        """Run stages that have to succeed, and all their rows in this process: that is quicker."""
        for name in names:
            for row in ROWS.get(name, [()]):
                outcome = self.stage(name, more=row)
                assert outcome.code == 0, (name, row, outcome.text)

    def start(self, name: str, environment: dict[str, str]) -> subprocess.Popen[str]:
        """Run one stage in a process of its own; what it says comes through one pipe.

        It hears Ctrl-C even where the tests run in the background, which do not.
        """
        return subprocess.Popen(
            [sys.executable, "-c", HEARING, "stage", name, "--scene", SCENE],
            cwd=self.folder,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )

    def edit(self, file: str, **changes: Any) -> None:
        """Set dotted keys of a YAML file; a key is written with __ for its dots."""
        yaml = YAML()
        path = self.folder / file
        document = yaml.load(path.read_text(encoding="utf-8"))
        for key, value in changes.items():
            *sections, leaf = key.split("__")
            place = document
            for section in sections:
                place = place[section]
            place[leaf] = value
        with path.open("w", encoding="utf-8") as stream:
            yaml.dump(document, stream)

    def replace(self, file: str, old: str, new: str) -> None:
        """Replace a piece of text that has to be there."""
        path = self.folder / file
        text = path.read_text(encoding="utf-8")
        assert old in text
        path.write_text(text.replace(old, new), encoding="utf-8")

    def snapshot(self) -> dict[str, tuple[str, int]]:
        """Content and time of change of every file below results/."""
        return {
            path.relative_to(self.folder).as_posix(): (
                hashlib.sha256(path.read_bytes()).hexdigest(),
                path.stat().st_mtime_ns,
            )
            for path in sorted((self.folder / "results").rglob("*"))
            if path.is_file()
        }

    def copy(self, folder: Path) -> Project:
        """The same in another folder, times of change included."""
        shutil.copytree(self.folder, folder)
        return Project(folder)


def new_project(folder: Path) -> Project:
    """The Cornell box at the sizes of `smoke`, in images of 20 by 16 pixels."""
    source = PROJECT / "scenes" / SCENE
    shutil.copytree(source, folder / "scenes" / SCENE)
    shutil.copy(PROJECT / "params.yaml", folder)
    project = Project(folder)
    few = {"classical": ["path_10"], "equal_time": [], "learned": []}
    project.edit("params.yaml", scenes=[SCENE], animation__scenes=[])
    project.replace(f"scenes/{SCENE}/views.yaml", "aspect: 1.0", "aspect: 1.25")
    with redirect_stderr(StringIO()):
        apply_profile("smoke", folder / "params.yaml")
    project.edit("params.yaml", methods=few, reference__images=3)
    return project


@pytest.fixture(scope="session")
def unused(tmp_path_factory: pytest.TempPathFactory) -> Project:
    """A project in which nothing has run; not to be changed."""
    return new_project(tmp_path_factory.mktemp("unused") / "project")


@pytest.fixture
def fresh(unused: Project, tmp_path: Path) -> Project:
    """A project in which nothing has run yet."""
    return unused.copy(tmp_path / "project")


@pytest.fixture(scope="session")
def built(unused: Project, tmp_path_factory: pytest.TempPathFactory) -> Project:
    """A project in which every stage has run once; not to be changed."""

    def make(folder: Path) -> None:
        unused.copy(folder / "project").run(*SMOKE_STAGES)

    return Project(made_once(tmp_path_factory, "built_project", make) / "project")


@pytest.fixture
def finished(built: Project, tmp_path: Path) -> Project:
    """A copy of a project in which every stage has run once."""
    return built.copy(tmp_path / "project")


@pytest.fixture
def environment() -> Callable[..., dict[str, str]]:
    """The environment for a process of its own that imports this project's packages."""

    def make(**more: str) -> dict[str, str]:
        return {**os.environ, "PYTHONPATH": str(PROJECT), "PYTHONWARNINGS": "default", **more}

    return make


@pytest.fixture
def no_probe(monkeypatch):
    """The passes that are only timed would be counted, too."""
    monkeypatch.setattr("stages.references.pass_times.compile_passes", lambda renderers: None)
    monkeypatch.setattr(
        "stages.references.pass_times.time_passes", lambda renderers, *_: np.ones(len(renderers))
    )


@pytest.fixture
def small_batches(monkeypatch):
    """Automatic numbers of photon paths are multiples of 10,000, not of 100,000."""
    monkeypatch.setattr("gpf.guiding.emission_plan.BATCH", 10_000)

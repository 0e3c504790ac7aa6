"""A project in which every stage has run once, and the process that runs are forked from."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import pytest

from tests.faults.cases import CASES, FRAMES, Case
from tests.faults.runner import SEED, Ending, Fault, Runner
from tests.faults.wholeness import assert_old_or_new, contents, lasting
from tests.made_once import made_once
from tests.stages.conftest import SCENE, Project, new_project


@dataclass(frozen=True)
class Trial:
    """A stage before a run that goes wrong: its old files, and those of a run that goes well."""

    case: Case
    runner: Runner
    before: Project

    @cached_property
    def old(self) -> dict[str, str]:
        """The files before."""
        return contents(self.before.folder / "results")

    @cached_property
    def well(self) -> tuple[Ending, dict[str, str]]:
        """A run without a fault, and its files."""
        project = self.before.copy(self.before.folder.parent / f"{self.case.stage}-well")
        ending = self.run(project)
        assert ending.code == 0, ending.said
        return ending, contents(project.folder / "results")

    def run(self, project: Project, fault: Fault | None = None) -> Ending:
        """Run the stage."""
        return self.runner.run(project.folder, *self.case.arguments, fault=fault)

    def survives(
        self, folder: Path, fault: Fault | None, may_end: Callable[[Ending], bool]
    ) -> None:
        """A copy of the project survives a fault: the run ends as it may, every file is the old
        one or the new one, and the next run makes the same bits."""
        project = self.before.copy(folder)
        ending = self.run(project, fault)
        assert may_end(ending), (SEED, fault, ending.code, ending.said)
        self.check(project)
        self.finish(project)

    def check(self, project: Project) -> None:
        """Every file is the old one or the new one."""
        assert_old_or_new(project.folder / "results", lasting(self.old), lasting(self.well[1]))

    def finish(self, project: Project) -> None:
        """The next run finishes, with the same bits as without the fault."""
        ending = self.run(project)
        assert ending.code == 0, ending.said
        found, wanted = contents(project.folder / "results"), self.well[1]
        assert found.keys() == wanted.keys(), found.keys() ^ wanted.keys()
        other = [name for name in wanted if found[name] != wanted[name]]
        assert not other, f"other bits: {other}"


@pytest.fixture(scope="session")
def runner() -> Iterator[Runner]:
    """Runs in processes of their own."""
    runner = Runner()
    yield runner
    runner.close()


@pytest.fixture(scope="session")
def ready(runner: Runner, tmp_path_factory: pytest.TempPathFactory) -> Project:
    """A project in which every stage has run; not to be changed."""

    def make(folder: Path) -> None:
        project = new_project(folder / "project")
        views = f"scenes/{SCENE}/views.yaml"
        project.replace(views, "frames: 24", f"frames: {FRAMES}")
        project.edit("params.yaml", animation__scenes=[SCENE], animation__methods=["gpf"])
        # Everything that it makes is saved at once, so that a kill finds something to go on with.
        project.edit("params.yaml", progress__checkpoint_seconds=1e-6)
        for case in CASES.values():
            ending = runner.run(project.folder, *case.arguments)
            assert ending.code == 0, ending.said

    return Project(made_once(tmp_path_factory, "faults_project", make) / "project")


@pytest.fixture(scope="session")
def trials(ready: Project, runner: Runner, tmp_path_factory: pytest.TempPathFactory):
    """Stage -> its trial."""
    folder, made = tmp_path_factory.mktemp("trials"), {}

    def trial(stage: str) -> Trial:
        if stage not in made:
            before = ready.copy(folder / stage)
            CASES[stage].prepare(before)
            made[stage] = Trial(CASES[stage], runner, before)
        return made[stage]

    return trial

"""A project with its code and dvc.yaml, as a checkout has them, and DVC run in it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from tests.stages.conftest import Project
from tests.stages.imports import PACKAGES, PROJECT


def add_pipeline(project: Project) -> None:
    """Give a project the code and dvc.yaml."""
    for name in ("dvc.yaml", ".dvcignore"):
        shutil.copy(PROJECT / name, project.folder)
    for name in (*PACKAGES, "scenes/modelling"):
        unwanted = shutil.ignore_patterns("__pycache__")
        shutil.copytree(PROJECT / name, project.folder / name, ignore=unwanted)


@dataclass(frozen=True)
class Checkout:
    """A project with a pipeline, git and DVC, and the environment for commands in it."""

    project: Project
    variables: Mapping[str, str]

    @classmethod
    def make(cls, project: Project, programs: Path, environment: Mapping[str, str]) -> Checkout:
        """Make a project one."""
        add_pipeline(project)
        checkout = cls.at(project, programs, environment)
        checkout.commit()
        return checkout

    @classmethod
    def at(cls, project: Project, programs: Path, environment: Mapping[str, str]) -> Checkout:
        """That of a project which is one, as a copy is; ``programs``: a folder for `python` and
        `gpf`, as an installation puts them there; the project's code is installed."""
        programs.mkdir(exist_ok=True)
        started = f'#!/bin/sh\nexec "{sys.executable}"'
        (programs / "python").write_text(f'{started} "$@"\n')
        script = programs / "start.py"
        script.write_text("from gpf.cli import main\nmain()\n")
        (programs / "gpf").write_text(f'{started} "{script}" "$@"\n')
        for name in ("python", "gpf"):
            (programs / name).chmod(0o755)
        path = [str(programs), str(Path(sys.executable).parent), os.environ["PATH"]]
        variables = {**environment, "PATH": os.pathsep.join(path)}
        variables |= {"PYTHONPATH": str(project.folder), "PYTHONDONTWRITEBYTECODE": "1"}
        for who in ("AUTHOR", "COMMITTER"):
            variables |= {f"GIT_{who}_{what}": "x@y" for what in ("NAME", "EMAIL")}
        return cls(project, variables)

    def commit(self) -> None:
        """Begin its history with what is there."""
        self.call("git", "init", "--quiet")
        self.dvc("init", "--quiet")
        self.call("git", "add", ".")
        self.call("git", "commit", "--quiet", "-m", "project")

    def start(self, *arguments: str) -> subprocess.Popen[str]:
        """Start a command; what it says comes through one pipe."""
        return subprocess.Popen(
            arguments,
            cwd=self.project.folder,
            env=self.variables,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )

    def start_dvc(self, *arguments: str) -> subprocess.Popen[str]:
        """Start DVC."""
        return self.start(sys.executable, "-m", "dvc", *arguments)

    def ends(self, *arguments: str) -> tuple[int, str]:
        """Run a command: its exit code, and what it said."""
        process = self.start(*arguments)
        try:
            said, _ = process.communicate(timeout=280)
        finally:
            process.kill()
        return process.returncode, said

    def call(self, *arguments: str) -> str:
        """What a command said that has to succeed."""
        code, said = self.ends(*arguments)
        assert code == 0, said
        return said

    def dvc(self, *arguments: str) -> str:
        """What DVC said, which has to succeed."""
        return self.call(sys.executable, "-m", "dvc", *arguments)

    def dvc_fails(self, *arguments: str) -> str:
        """What DVC said, which has to fail."""
        code, said = self.ends(sys.executable, "-m", "dvc", *arguments)
        assert code != 0, said
        return said

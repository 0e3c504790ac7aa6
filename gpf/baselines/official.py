"""The code that the authors of a system published, run as it is, in a process of its own.

Such code wants packages in versions that do not go together with this project's, so that it has a
folder and, if it needs one, an environment of its own: ``.venv`` in that folder. An environment
variable says where the folder is. The scripts in :mod:`gpf.baselines.programs` are what runs there.
They never use the network: weights have to be in a folder, or in the Hugging Face cache.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import weakref
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from gpf.baselines.protocol import CannotServe
from gpf.core.subprocesses import last_line

PROGRAMS = Path(__file__).parent / "programs"


@dataclass(frozen=True)
class OfficialCode:
    """Published code.

    Attributes
    ----------
    name: the system's. variable: of the environment, names the folder with a copy of ``source``.
    file: is there in every copy.
    """

    name: str
    source: str
    variable: str
    file: str

    @property
    def install(self) -> str:
        """The commands that bring it."""
        return (
            f"git clone {self.source} {self.name} && cd {self.name} && python3 -m venv .venv && "
            f".venv/bin/pip install torch -r requirements.txt && export {self.variable}=$PWD"
        )

    def find(self) -> Path:
        """The folder of the copy.

        Raises
        ------
        CannotServe: the variable is not set, or names something else.
        """
        named = os.environ.get(self.variable)
        if not named:
            raise CannotServe(
                self.name,
                f"package not installed: {self.variable} does not say where",
                f"Run `{self.install}`, or set {self.variable} to the folder of a copy.",
            )
        folder = Path(named).expanduser().absolute()
        if not (folder / self.file).is_file():
            raise CannotServe(
                self.name,
                f"package not installed: {self.variable}={named} has no {self.file}",
                f"Set it to the folder of a copy of {self.source}.",
            )
        return folder

    def find_interpreter(self) -> Path:
        """The Python of the copy's own environment, or this one."""
        own = self.find() / ".venv" / "bin" / "python"
        return own if own.exists() else Path(sys.executable)


class Program:
    """A script of :mod:`gpf.baselines.programs` that runs and answers.

    Parameters
    ----------
    code: the published code that it needs.
    script: its name.
    settings: JSON values that it is started with; ``weights`` is a folder or a name of the Hugging
        Face hub.
    folder: where it works, and writes ``program.log``: what it and the published code print.

    Raises
    ------
    CannotServe: as ``ask`` does.
    """

    def __init__(
        self, code: OfficialCode, script: str, settings: Mapping[str, Any], folder: Path
    ) -> None:
        self.code, self.log = code, folder / "program.log"
        settings = {"code": str(code.find()), **settings}
        weights = Path(settings["weights"]).expanduser()
        if weights.is_dir():  # the program works elsewhere
            settings["weights"] = str(weights.absolute())
        command = [str(code.find_interpreter()), str(PROGRAMS / script)]
        with self.log.open("w", encoding="utf-8") as log:
            self.process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                cwd=folder,
                env=os.environ | {"HF_HUB_OFFLINE": "1", "PYTHONUNBUFFERED": "1"},
                text=True,
                encoding="utf-8",
            )
        self.close = weakref.finalize(self, _end, self.process)
        self.started = self.ask(settings)
        """What it says of itself: at least ``device``."""

    def ask(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Send JSON values and wait for the answer.

        Raises
        ------
        CannotServe: it refuses, fails or has ended.
        """
        assert self.process.stdin is not None and self.process.stdout is not None
        try:
            self.process.stdin.write(json.dumps(request) + "\n")
            self.process.stdin.flush()
            line = self.process.stdout.readline()
        except BrokenPipeError:
            line = ""
        if not line:
            raise self._ended()
        answer: dict[str, Any] = json.loads(line)
        if "refused" in answer:
            raise CannotServe(self.code.name, answer["refused"], answer["todo"])
        return answer

    def _ended(self) -> CannotServe:
        status = self.process.wait()
        how = f"signal {-status}" if status < 0 else f"status {status}"
        said = last_line(self.log.read_text(encoding="utf-8", errors="replace"))
        return CannotServe(
            self.code.name,
            f"the official code ended with {how}: {said.rstrip('.')}",
            f"Its output is in {self.log}; it was run by {self.code.find_interpreter()}. "
            f"If a package is missing there: pip install -r {self.code.find()}/requirements.txt",
        )


def _end(process: subprocess.Popen[str]) -> None:
    """Close the pipes, which ends the program once it has nothing left to do."""
    _close(process.stdin)
    try:
        process.wait(5)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    _close(process.stdout)


def _close(pipe: IO[str] | None) -> None:
    try:
        if pipe is not None:
            pipe.close()
    except BrokenPipeError:  # what was not read by then is of no use
        pass

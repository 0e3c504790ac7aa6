"""Other people's programs, run unchanged in a subprocess.

They need package versions that conflict with this project's. Code published by the authors of a
system has a folder of its own, which an environment variable names and which may contain a virtual
environment, ``.venv``; other renderers are where their adapters find them. The scripts in
:mod:`baselines.programs` run there. They never use the network: weights must be in a folder or in
the Hugging Face cache.
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
from typing import IO, Any, Protocol

from baselines.protocol import CannotServe
from gpf.core.subprocesses import last_line

PROGRAMS = Path(__file__).parent / "programs"


class Host(Protocol):
    """What a script needs to run."""

    @property
    def name(self) -> str:
        """The system's name."""

    def command(self) -> list[str]:
        """The command that runs a script, up to the script's path; raises :class:`CannotServe` if
        it is not installed."""

    def settings(self) -> dict[str, Any]:
        """What a script must be told about the place of the code."""

    def advice(self) -> str:
        """What to do if a script ends."""


@dataclass(frozen=True)
class OfficialCode:
    """Published code of a system.

    Attributes
    ----------
    name: the system's name.
    source: URL of the repository.
    variable: environment variable that names the folder with a copy of ``source``.
    file: path of a file that every copy has.
    """

    name: str
    source: str
    variable: str
    file: str

    @property
    def install(self) -> str:
        """The commands that install it."""
        return (
            f"git clone {self.source} {self.name} && cd {self.name} && python3 -m venv .venv && "
            f".venv/bin/pip install torch -r requirements.txt && export {self.variable}=$PWD"
        )

    def find(self) -> Path:
        """The folder of the copy.

        Raises
        ------
        CannotServe: the variable is not set, or its folder is not a copy.
        """
        named = os.environ.get(self.variable)
        if not named:
            raise CannotServe(
                self.name,
                f"package not installed: {self.variable} is not set",
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
        """The Python of the copy's own environment; without one, this process's Python."""
        own = self.find() / ".venv" / "bin" / "python"
        return own if own.exists() else Path(sys.executable)

    def command(self) -> list[str]:
        """The interpreter."""
        return [str(self.find_interpreter())]

    def settings(self) -> dict[str, Any]:
        """The folder of the copy."""
        return {"code": str(self.find())}

    def advice(self) -> str:
        """What to do if a script ends."""
        return (
            f"{self.find_interpreter()} ran it. If a package is missing there: "
            f"pip install -r {self.find()}/requirements.txt"
        )


class Program:
    """A running script of :mod:`baselines.programs`.

    Parameters
    ----------
    host: what the script needs.
    script: the script's file name.
    settings: JSON values of the first request; ``weights`` is a folder or a name on the Hugging
        Face hub.
    folder: the working directory. ``program.log`` there receives everything else that is printed.

    Raises
    ------
    CannotServe: as in :meth:`ask`.
    """

    def __init__(self, host: Host, script: str, settings: Mapping[str, Any], folder: Path) -> None:
        self.host, self.log = host, folder / "program.log"
        settings = {**host.settings(), **settings}
        if "weights" in settings:
            weights = Path(settings["weights"]).expanduser()
            if weights.is_dir():  # the program's working directory differs
                settings["weights"] = str(weights.absolute())
        command = [*host.command(), str(PROGRAMS / script)]
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
        """The answer to the first request: at least ``device``."""

    def ask(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Send a request of JSON values and wait for the answer.

        Raises
        ------
        CannotServe: the program refuses the request, fails or has ended.
        """
        assert self.process.stdin is not None and self.process.stdout is not None
        try:
            self.process.stdin.write(json.dumps(request) + "\n")
            self.process.stdin.flush()
            # What a host prints before its script runs is no answer.
            line = next((said for said in self.process.stdout if said.startswith("{")), "")
        except BrokenPipeError:
            line = ""
        if not line:
            raise self._ended()
        answer: dict[str, Any] = json.loads(line)
        if "refused" in answer:
            raise CannotServe(self.host.name, answer["refused"], answer["todo"])
        return answer

    def _ended(self) -> CannotServe:
        status = self.process.wait()
        how = f"signal {-status}" if status < 0 else f"status {status}"
        said = last_line(self.log.read_text(encoding="utf-8", errors="replace"))
        return CannotServe(
            self.host.name,
            f"the program ended with {how}: {said.rstrip('.')}",
            f"Its output is in {self.log}; {self.host.advice()}",
        )


def _end(process: subprocess.Popen[str]) -> None:
    """Close the input, which ends the program; after 5 seconds, kill it."""
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
    except BrokenPipeError:  # the program has ended; it does not need the rest
        pass

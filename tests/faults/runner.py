"""Runs of the command line in processes of their own, and what goes wrong in them."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

PROJECT = Path(__file__).parents[2]
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(PROJECT), "OMP_NUM_THREADS": "1"}

SEED = int(os.environ.get("GPF_FAULT_SEED", "26"))
MOMENTS = int(os.environ.get("GPF_FAULT_MOMENTS", "2"))
"""How many moments of each stage are tried: ``GPF_FAULT_MOMENTS=20 make test-all`` tries 20."""

SIGNALS = {
    "SIGTERM": (signal.SIGTERM,),
    "SIGHUP": (signal.SIGHUP,),
    "Ctrl-C": (signal.SIGINT,),
    "Ctrl-C twice": (signal.SIGINT, signal.SIGINT),
}


@dataclass(frozen=True)
class Fault:
    """What happens to a run.

    Attributes
    ----------
    before_change: SIGKILL just before so many-th change of a file: opened for writing, renamed,
        removed.
    signals, after: signals, the first of them after so many seconds.
    file_size: no file can have more bytes.
    clock: whether the clock jumps by days.
    unprivileged: whether permissions hold for root as well.
    """

    before_change: int | None = None
    signals: tuple[int, ...] = ()
    after: float = 0
    file_size: int | None = None
    clock: bool = False
    unprivileged: bool = False


@dataclass(frozen=True)
class Ending:
    """How a run ended: its exit code (negative: the signal), what it said, its seconds, and how
    often it changed a file."""

    code: int
    said: str
    seconds: float
    changes: int

    def is_in_words(self) -> bool:
        """Whether it told an error without a traceback; typer writes it in a frame."""
        told = "error:" in self.said or "─ Error ─" in self.said
        return self.code == 2 and told and "Traceback" not in self.said


class Runner:
    """Starts runs; end it with :meth:`close`."""

    def __init__(self) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-m", "tests.faults.server"],
            cwd=PROJECT,
            env=ENVIRONMENT,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def run(
        self, folder: Path, *arguments: str, fault: Fault | None = None, small: bool = False
    ) -> Ending:
        """Run ``gpf`` with these arguments in a folder; ``small``: fits take a second."""
        order = {
            "folder": str(folder),
            "arguments": arguments,
            "small": small,
            "fault": asdict(fault or Fault()),
        }
        assert self.process.stdin is not None and self.process.stdout is not None
        print(json.dumps(order), file=self.process.stdin, flush=True)
        return Ending(**json.loads(self.process.stdout.readline()))

    def close(self) -> None:
        """End the process that runs are forked from."""
        self.process.communicate()


def moment(what: str, number: int, whole: Ending) -> Fault:
    """A random moment at which a run is killed: in turn before a change of a file, and at a time.

    ``whole``: the run without a fault.
    """
    chance = random.Random(f"{SEED} {what} {number}")
    if number % 2 == 0:
        return Fault(before_change=chance.randint(1, whole.changes))
    return Fault(signals=(signal.SIGKILL,), after=chance.uniform(0, whole.seconds))

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
    signals, before_change: the first signal comes just before this change of a file (opened for
        writing, renamed, removed), counted from 1, and each further one a change later.
    file_size: no file can have more bytes.
    clock: whether the clock jumps by days.
    unprivileged: whether permissions hold for root as well.
    """

    signals: tuple[int, ...] = ()
    before_change: int = 0
    file_size: int | None = None
    clock: bool = False
    unprivileged: bool = False


@dataclass(frozen=True)
class Ending:
    """How a run ended: its exit code (negative: the signal), what it said, and how often it changed
    a file."""

    code: int
    said: str
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


def at_random(what: str, signals: tuple[int, ...], whole: Ending) -> Fault:
    """Signals at a random moment of a run.

    ``whole``: the run without a fault.
    """
    chance = random.Random(f"{SEED} {what}")
    return Fault(signals, before_change=chance.randint(1, whole.changes))

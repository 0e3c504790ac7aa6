"""Runs cases in workers: one that dies or hangs is noticed, named and replaced."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

PROJECT = Path(__file__).resolve().parents[2]

PATIENCE = 60.0
"""Seconds after which a case counts as a hang; most take less than half a second."""

WORKER = ("-m", "tests.fuzz.worker")

GOOD = ("worked", "refused")
BAD = ("traceback", "exit code", "unnamed", "hang", "crash", "outside")


@dataclass(frozen=True)
class Ending:
    """How a case ended: one of :data:`GOOD` or :data:`BAD`, and what was said or found."""

    kind: str
    seed: int
    number: int
    outcome: str
    words: tuple[str, ...] = ()
    what: str = ""

    def __str__(self) -> str:
        again = f"python -m tests.fuzz --kind {self.kind} --seed {self.seed} --only {self.number}"
        return f"{self.outcome}: {again}\n  gpf {' '.join(self.words)[:300]}\n  {self.what}"


@dataclass
class Tally:
    """All endings."""

    endings: list[Ending] = field(default_factory=list)

    @property
    def faults(self) -> list[Ending]:
        """Those that may not be."""
        return [ending for ending in self.endings if ending.outcome not in GOOD]

    def table(self) -> str:
        """The number of cases by kind and outcome, as text."""
        counts = Counter((ending.kind, ending.outcome) for ending in self.endings)
        kinds = list(dict.fromkeys(ending.kind for ending in self.endings))
        rows = [["kind", "cases", *GOOD, *BAD]]
        for kind in [*kinds, "all"]:
            numbers = [
                sum(n for (k, o), n in counts.items() if kind in (k, "all") and o == outcome)
                for outcome in (*GOOD, *BAD)
            ]
            rows.append([kind, str(sum(numbers)), *(str(n) for n in numbers)])
        widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
        return "\n".join(
            "  ".join(w.rjust(n) for w, n in zip(r, widths, strict=True)) for r in rows
        )


def run_cases(shares: Mapping[str, int], seed: int, root: Path, first: int = 0) -> Tally:
    """Run so many cases of each kind.

    Parameters
    ----------
    root: a folder for the files of the cases.
    first: number of the first case.
    """
    tally = Tally()
    for kind, count in shares.items():
        todo = range(first, first + count)
        while todo:
            done = list(run_worker(kind, seed, todo, root))
            tally.endings += done
            todo = range(todo.start + len(done), todo.stop)
    return tally


def run_worker(kind: str, seed: int, todo: range, root: Path) -> Iterator[Ending]:
    """The endings of cases until all are done, or until one ends the worker or hangs."""
    reading, writing = os.pipe()
    log = root / "worker.log"
    command = [sys.executable, *WORKER, kind, str(seed)]
    command += [str(todo.start), str(todo.stop), str(root), str(writing)]
    environment = {
        **os.environ,
        "PYTHONPATH": str(PROJECT),
        "PYTHONDONTWRITEBYTECODE": "1",
        "COLUMNS": "500",  # messages in one line
        "GPF_SCENES": "",
    }
    with log.open("wb") as stream:
        process = subprocess.Popen(
            command,
            cwd=PROJECT,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=stream,
            stderr=stream,
            pass_fds=(writing,),
        )
    os.close(writing)
    words: tuple[str, ...] = ()
    number = todo.start
    begun = False
    try:
        for line in _lines(reading):
            if line is None:
                yield Ending(kind, seed, number, "hang", words, f"after {PATIENCE:g} s")
                return
            begun = True
            if "words" in line:
                number, words = line["number"], tuple(line["words"])
            if "outcome" in line:
                yield Ending(kind, seed, number, line["outcome"], words, line["what"])
                number, words = number + 1, ()
        said = log.read_text(errors="replace")
        said = said[max(0, said.rfind("Fatal Python error")) :].partition("Extension modules")[0]
        if not begun:
            raise RuntimeError(f"No worker starts: {said[-2000:]}")
        if number < todo.stop:
            code = process.wait(10)
            name = signal.Signals(-code).name if code < 0 else f"code {code}"
            yield Ending(kind, seed, number, "crash", words, f"{name}: {said[:3000]}")
    finally:
        process.kill()
        process.wait()
        os.close(reading)


def _lines(reading: int) -> Iterator[dict[str, Any] | None]:
    """What comes through the pipe; None if nothing comes for too long."""
    rest = b""
    begin = time.monotonic()
    while True:
        ready, _, _ = select.select([reading], [], [], max(0, begin + PATIENCE - time.monotonic()))
        if not ready:
            yield None
            return
        data = os.read(reading, 65536)
        if not data:
            return
        begin = time.monotonic()
        *lines, rest = (rest + data).split(b"\n")
        yield from map(json.loads, lines)

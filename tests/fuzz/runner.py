"""Runs cases in a worker process: one that dies or hangs is noticed and replaced."""

from __future__ import annotations

import multiprocessing
import os
import shutil
import signal
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from pathlib import Path

from tests.fuzz.case import Case
from tests.fuzz.worker import GOOD, Outcome, begin, run_case


class Runner:
    """Runs one case after the other; the files of the last one stay in `root / "case"`.

    Parameters
    ----------
    run: what the worker does with a case.
    patience: seconds after which a case counts as a hang; most take less than half a second.
    """

    def __init__(
        self,
        root: Path,
        run: Callable[[Case, Path], Outcome] = run_case,
        patience: float = 60,
    ) -> None:
        self.folder, self.log = root.resolve() / "case", root / "worker.log"
        self.run, self.patience = run, patience
        self.pool: ProcessPoolExecutor | None = None

    def start(self) -> ProcessPoolExecutor:
        """Start a worker."""
        spawn = multiprocessing.get_context("spawn")
        pool = ProcessPoolExecutor(1, spawn, initializer=begin, initargs=(self.log,))
        self.process = pool.submit(os.getpid).result()
        self.pool = pool
        return pool

    def stop(self) -> None:
        """End the worker, if there is one."""
        if self.pool:
            with suppress(ProcessLookupError):
                os.kill(self.process, signal.SIGKILL)
            self.pool.shutdown()
            self.pool = None

    def outcome(self, case: Case) -> Outcome:
        """Run a case."""
        shutil.rmtree(self.folder, ignore_errors=True)
        try:
            pool = self.pool or self.start()
            ending = pool.submit(self.run, case, self.folder).result(self.patience)
        except TimeoutError:
            ending = "hang", f"after {self.patience:g} s"
        except BrokenProcessPool:
            said = self.log.read_text(errors="replace")
            said = said[max(0, said.rfind("Fatal Python error")) :]
            ending = "crash", said.partition("Extension modules")[0]
        if ending[0] not in GOOD:
            self.stop()
        return ending

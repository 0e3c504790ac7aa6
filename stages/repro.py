"""`gpf repro`: `dvc repro` for people: which stage of how many, and how much time is left."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TextIO

from rich.console import Console
from rich.live import Live
from rich.text import Text

from gpf.errors import UserError
from stages.code import CODE_FOLDER, record_code
from stages.progress import RELAY, console, read_relayed, say
from stages.repro_plan import Durations, DvcFailed, Plan

LOG = Path("results") / "repro.log"

# Lines of a stage that failed which are shown.
SHOWN = 40

_RUNS = re.compile(r"^Running (?:callback )?stage '(.+)':")
_SKIPS = re.compile(r"^Stage '(.+)' (?:didn't change, skipping|is cached - skipping run)")
_FAILS = re.compile(r"^(?:ERROR|WARNING): failed to (?:reproduce|run)")


def reproduce(arguments: Sequence[str]) -> int:
    """Run `dvc repro` with these arguments, tell how far it is, and return its exit code.

    What DVC and the stages say goes to :data:`LOG`; of a stage that fails, it is shown. Ctrl-C
    stops the stage that runs, which keeps what it has, and the next call goes on from there.
    """
    if not Path("dvc.yaml").exists():
        todo = "Run `gpf repro` in the project's folder."
        raise UserError("dvc.yaml", "is missing", todo)
    dvc = [sys.executable, "-m", "dvc"]
    if {"--help", "-h"} & set(arguments):
        return subprocess.call([*dvc, "repro", *arguments])
    if CODE_FOLDER.exists():
        record_code()  # as the stage `code` will: DVC can tell now which others that concerns
    if "--dry" in arguments:  # nothing runs that could be watched
        return subprocess.call([*dvc, "repro", *arguments])
    try:
        plan = Plan.read(dvc, arguments)
    except DvcFailed as error:
        say(str(error))
        return error.code
    run = Run(plan, Durations.read(list(plan.before)), console)
    LOG.parent.mkdir(parents=True, exist_ok=True)
    with (
        LOG.open("w", encoding="utf-8") as log,
        run.shown(),
        start([*dvc, "repro", *arguments]) as process,
        forwarded(process, run) as stopped,
    ):
        code = follow(process, run, log)
    if stopped:
        run.tell(f"stopped after {run.so_far()}; `gpf repro` goes on from there")
        return 130
    run.tell_end(code)
    return code


def start(command: Sequence[str]) -> subprocess.Popen[str]:
    """A process whose words come through one pipe, line by line."""
    # The stages' command is found beside Python, whether or not the environment is activated.
    places = [str(Path(sys.executable).parent), os.environ.get("PATH", "")]
    return subprocess.Popen(
        command,
        env={
            **os.environ,
            "PATH": os.pathsep.join(places),
            "PYTHONUNBUFFERED": "1",
            RELAY: "1",
        },
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        encoding="utf-8",
        errors="replace",
        start_new_session=True,  # signals reach it by way of `forwarded` alone, once
    )


def follow(process: subprocess.Popen[str], run: Run, log: TextIO) -> int:
    """Keep what the process says, and let the run see every line of it."""
    assert process.stdout is not None
    for line in process.stdout:
        run.inside = read_relayed(line)
        if run.inside is None:
            log.write(line)
            log.flush()
            run.see(line.rstrip("\n"))
    code = process.wait()
    run.end_stage()
    return code


@contextmanager
def forwarded(process: subprocess.Popen[str], run: Run) -> Iterator[list[int]]:
    """While the block runs, what is to end this process ends the other one and its children.

    The yielded list has the signals that came. The first is passed on as Ctrl-C, on which stages
    keep what they have; further ones end them at once.
    """
    came: list[int] = []

    def forward(number: int, _frame: object) -> None:
        came.append(number)
        run.stopping = True
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGINT if len(came) == 1 else signal.SIGKILL)

    ends = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    # What is ignored stays so: nohup wants it.
    before = {end: signal.getsignal(end) for end in ends}
    caught = [end for end, handler in before.items() if handler != signal.SIG_IGN]
    for end in caught:
        signal.signal(end, forward)
    try:
        yield came
    finally:
        for end in caught:
            signal.signal(end, before[end])


@dataclass
class Run:
    """How far `dvc repro` is, as far as its lines tell."""

    plan: Plan
    durations: Durations
    console: Console
    started: float = field(default_factory=time.monotonic)
    current: str | None = None
    current_since: float = 0.0
    ran: list[str] = field(default_factory=list)
    skipped: list[str] = field(default_factory=list)
    failed: list[str] = field(default_factory=list)
    said: list[str] = field(default_factory=list)
    inside: str | None = None
    stopping: bool = False

    @contextmanager
    def shown(self) -> Iterator[None]:
        """Show it in a line that changes, where there is a terminal."""
        if not self.console.is_terminal:
            yield
            return
        with Live(
            console=self.console,
            get_renderable=lambda: Text(self.line(), no_wrap=True, overflow="ellipsis"),
            refresh_per_second=2,
            transient=True,
        ):
            yield

    def see(self, line: str) -> None:
        """Take in a line of DVC or of a stage."""
        if runs := _RUNS.match(line):
            self.end_stage()
            self.current, self.current_since, self.said = runs[1], time.monotonic(), []
            if not self.console.is_terminal:
                self.tell(self.line())
        elif skips := _SKIPS.match(line):
            self.end_stage()
            self.skipped.append(skips[1])
        elif _FAILS.match(line):
            self._tell_failure(line)
        else:
            self.said.append(line)

    def end_stage(self) -> None:
        """The stage that ran has ended."""
        if self.current is None:
            return
        name, seconds = self.current, time.monotonic() - self.current_since
        self.current = None
        if name in self.failed or self.stopping:
            return
        self.durations.now[name] = seconds
        self.ran.append(name)
        self.tell(f"{self._place(self.done)} {name}: {_span(seconds)}")

    @property
    def done(self) -> int:
        """How many stages are behind."""
        return len(self.ran) + len(self.skipped) + len(self.failed)

    def line(self) -> str:
        """The stage that runs, and the time that is left."""
        if self.stopping:
            return "stopping"
        if self.current is None:
            return f"{self._place(self.done)} looking for what is out of date"
        elapsed, expected = self._elapsed(), self.durations.expect(self.current)
        text = f"{self._place(self.done + 1)} {self.current}"
        if self.console.is_terminal:
            text += f" {_span(elapsed)}"
            if expected is not None and elapsed < expected:
                text += f" of about {_span(expected)}"
            # Last, for there may be no room for it. Read once: another thread may change it.
            inside = self.inside
            return f"{text}; {self.time_left()}" + (f" | {inside}" if inside else "")
        return f"{text}; {self.time_left()}"

    def time_left(self) -> str:
        """In words."""
        behind = {*self.ran, *self.failed}
        left = [name for name in self.plan.left(behind, self.skipped) if name != self.current]
        expected = [self.durations.expect(name) for name in left]
        if self.current is not None:
            whole = self.durations.expect(self.current)
            expected.append(None if whole is None else max(whole - self._elapsed(), 0.0))
        known = sum(seconds for seconds in expected if seconds is not None)
        if None not in expected:
            return f"about {_span(known)} left"
        return f"more than {_span(known)} left" if known >= 1 else "time left not known yet"

    def so_far(self) -> str:
        """What is behind, in words."""
        whole, ended = max(len(self.plan.before), self.done), self.done - len(self.failed)
        return f"{ended} of {whole} stages, {_span(time.monotonic() - self.started)}"

    def tell_end(self, code: int) -> None:
        """Say how it ended."""
        if code == 0:
            up_to_date = f"{len(self.skipped)} were up to date"
            took = _span(time.monotonic() - self.started)
            self.tell(f"done: {len(self.ran)} stages ran, {up_to_date}; {took}")
            return
        if not self.failed:  # DVC itself: before any stage, or between two of them
            self._show(self.said)
        self.tell(f"failed after {self.so_far()}; all that was said: {LOG}")

    def _tell_failure(self, line: str) -> None:
        """Show what a stage that failed has said; DVC may say more than once that it failed."""
        if self.stopping:
            return
        name = self.current or "dvc"
        if name not in self.failed:
            self.failed.append(name)
            self.tell(f"{self._place(self.done)} {name} failed")
            self._show(self.said)
        self._show([line])

    def _show(self, lines: Sequence[str]) -> None:
        for line in lines[-SHOWN:]:
            self.tell(f"  {line}")

    def tell(self, text: str) -> None:
        """A line that stays."""
        self.console.print(text, highlight=False, markup=False, soft_wrap=True)

    def _place(self, number: int) -> str:
        return f"[{number}/{max(len(self.plan.before), number)}]"

    def _elapsed(self) -> float:
        return time.monotonic() - self.current_since


def _span(seconds: float) -> str:
    """A length of time for people."""
    if seconds < 99.5:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 100 else f"{minutes // 60} h {minutes % 60:02} min"

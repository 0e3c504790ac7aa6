"""What a stage tells while it runs: lines, and progress bars with rate and time left."""

from __future__ import annotations

import os
import re
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TaskID,
    TextColumn,
    TimeRemainingColumn,
)
from rich.text import Text

console = Console(stderr=True)

RELAY = "GPF_RELAY_PROGRESS"
"""Where it is set, bars are also told as lines, for a program that watches the stage."""

RELAY_SECONDS = 0.5

# A record separator: nothing that a stage says begins so.
_LINE = re.compile("^\x1e([0-9]+)/([0-9]+) (.*)")


def say(text: str) -> None:
    """A line of text, however long, as it is: nothing in it is coloured, or taken for markup."""
    console.print(text, highlight=False, soft_wrap=True, markup=False)


class _Rate(ProgressColumn):
    """Steps per second."""

    def render(self, task: Task) -> Text:
        speed = task.finished_speed or task.speed
        return Text("" if speed is None else f"{speed:.1f}/s", style="progress.data.speed")


class Bar:
    """A progress bar while it is shown."""

    def __init__(self, progress: Progress, task: TaskID) -> None:
        self._progress, self._task = progress, task
        self._told = float("-inf")

    def __call__(self, done: int, total: int | None = None) -> None:
        """Move to so many steps, of ``total`` if that has turned out to be another number."""
        self._progress.update(self._task, completed=done, total=total)
        if RELAY in os.environ and time.monotonic() - self._told > RELAY_SECONDS:
            self._told = time.monotonic()
            task = self._progress.tasks[self._task]
            line = f"\x1e{done}/{task.total:.0f} {task.description}"
            # Not to `sys.stderr`: where rich draws, it puts its own in that place.
            print(line, file=sys.__stderr__, flush=True)

    def describe(self, text: str) -> None:
        """Change the words beside the bar."""
        self._progress.update(self._task, description=text)


def read_relayed(line: str) -> str | None:
    """What a bar told in a line, in words; None for a line that no bar wrote."""
    found = _LINE.match(line)
    return None if found is None else f"{found[3]} {found[1]}/{found[2]}"


@contextmanager
def progress_bar(description: str, total: int) -> Iterator[Bar]:
    """A bar on standard error; the yielded object is called with the number of steps done."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        _Rate(),
        TimeRemainingColumn(elapsed_when_finished=True),
    )
    with Progress(*columns, console=console) as progress:
        yield Bar(progress, progress.add_task(description, total=total))

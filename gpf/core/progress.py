"""What people are told while something runs: lines, and progress bars with rate and time left."""

from __future__ import annotations

import logging
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


def say(text: str) -> None:
    """A line of text, however long, as it is: nothing in it is coloured, or taken for markup."""
    console.print(text, highlight=False, soft_wrap=True, markup=False)


class _Sayer(logging.Handler):
    """Says what the library logs."""

    def emit(self, record: logging.LogRecord) -> None:
        say(self.format(record))


def show_log() -> None:
    """Show people what the library logs: programs call it once, libraries do not."""
    logger = logging.getLogger("gpf")
    if not any(isinstance(handler, _Sayer) for handler in logger.handlers):
        logger.addHandler(_Sayer())
        logger.setLevel(logging.INFO)


class _Rate(ProgressColumn):
    """Steps per second."""

    def render(self, task: Task) -> Text:
        speed = task.finished_speed or task.speed
        return Text("" if speed is None else f"{speed:.1f}/s", style="progress.data.speed")


class Bar:
    """A progress bar while it is shown."""

    def __init__(self, progress: Progress, task: TaskID) -> None:
        self._progress, self._task = progress, task

    def __call__(self, done: int, total: int | None = None) -> None:
        """Move to so many steps, of ``total`` if that has turned out to be another number."""
        self._progress.update(self._task, completed=done, total=total)

    def describe(self, text: str) -> None:
        """Change the words beside the bar."""
        self._progress.update(self._task, description=text)


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

"""Messages and progress bars on standard error."""

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
    """Print a line of text without wrapping, colours or markup."""
    console.print(text, highlight=False, soft_wrap=True, markup=False)


class _LogPrinter(logging.Handler):
    """Prints log records with :func:`say`."""

    def emit(self, record: logging.LogRecord) -> None:
        say(self.format(record))


def show_log() -> None:
    """Print ``gpf`` log messages of level INFO and above; for programs, not for libraries."""
    logger = logging.getLogger("gpf")
    if not any(isinstance(handler, _LogPrinter) for handler in logger.handlers):
        logger.addHandler(_LogPrinter())
        logger.setLevel(logging.INFO)


class _Rate(ProgressColumn):
    """Steps per second."""

    def render(self, task: Task) -> Text:
        speed = task.finished_speed or task.speed
        return Text("" if speed is None else f"{speed:.1f}/s", style="progress.data.speed")


class Bar:
    """A progress bar on the screen."""

    def __init__(self, progress: Progress, task: TaskID) -> None:
        self._progress, self._task = progress, task

    def __call__(self, done: int, total: int | None = None) -> None:
        """Show ``done`` steps; ``total``, if given, is the new total."""
        self._progress.update(self._task, completed=done, total=total)

    def describe(self, text: str) -> None:
        """Change the text beside the bar."""
        self._progress.update(self._task, description=text)


@contextmanager
def progress_bar(description: str, total: int) -> Iterator[Bar]:
    """Show a bar with rate and remaining time; call the bar with the number of steps done."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        _Rate(),
        TimeRemainingColumn(elapsed_when_finished=True),
    )
    with Progress(*columns, console=console) as progress:
        yield Bar(progress, progress.add_task(description, total=total))

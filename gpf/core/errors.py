"""Errors that a user can correct: they say where, what is wrong and what to do."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any


class UserError(Exception):
    """A file, a value or an object is wrong, and the user can correct it.

    The command line prints the message without a traceback and exits with code 2; callers of the
    library catch it like any exception.

    Parameters
    ----------
    where: the file, key or object that is wrong, e.g. ``views.yaml: exposure``.
    what: what is wrong with it, e.g. ``is -1``.
    todo: what the user can do, as a request: ``Choose a number above 0.``
    """

    exit_code = 2

    def __init__(self, where: str, what: str, todo: str) -> None:
        self.where, self.what, self.todo = where, what, todo
        super().__init__(f"{where}: {what}. {todo}")

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.where, self.what, self.todo)


class FileError(UserError):
    """A file is missing, damaged or of another kind than expected.

    A program that knows which command makes the file can add it to the message.

    Parameters
    ----------
    path: the file.
    what: what is wrong with it.
    missing: whether the file does not exist.
    """

    def __init__(self, path: Path, what: str, missing: bool = False) -> None:
        self.path, self.missing = Path(path), missing
        super().__init__(
            str(path), what, "Check the path." if missing else "Delete it and make it again."
        )

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.path, self.what, self.missing)


def is_interrupt(error: BaseException | None) -> bool:
    """Whether Ctrl-C caused an error: inside a loop, Dr.Jit raises another error from it."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Ctrl-C waits until the block ends: for values that have to change together."""
    before = signal.getsignal(signal.SIGINT)
    # Signals reach the main thread alone, and a handler that is not of Python stays as it is.
    if threading.current_thread() is not threading.main_thread() or not callable(before):
        yield
        return
    received: list[tuple[int, Any]] = []
    signal.signal(signal.SIGINT, lambda *arguments: received.append(arguments))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        if received:
            before(*received[0])

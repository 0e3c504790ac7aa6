"""Errors that a user can correct: they say what is wrong, where, and what to do."""

from __future__ import annotations

import errno
import os
import re
import signal
import sys
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
    todo: what the user can do, as an instruction: ``Choose a number above 0.``
    """

    exit_code = 2

    def __init__(self, where: str, what: str, todo: str) -> None:
        self.where, self.what, self.todo = where, what, todo
        super().__init__(f"{where}: {what}. {todo}")

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.where, self.what, self.todo)


class FileError(UserError):
    """A file is missing, damaged or not of the expected kind.

    A program that knows which command creates the file can add it to the message.

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


class WriteError(UserError):
    """A file could not be written: the disk is full, or the folder is not writable."""

    def __init__(self, path: Path | str, why: object) -> None:
        self.path, self.why = path, str(why)
        super().__init__(
            str(path), f"could not be written ({why})", "Free some disk space or check the folder."
        )

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.path, self.why)


# No space, no permission, a file where a folder should be or vice versa, a name that is too long,
# circular links, a failing disk, too many open files, a network share that is gone.
_OF_FILES = (
    *(errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EACCES, errno.EPERM),
    *(errno.ENOTDIR, errno.EISDIR, errno.EEXIST, errno.ENOTEMPTY),
    *(errno.ENAMETOOLONG, errno.ELOOP, errno.EIO, errno.EMFILE, errno.ENFILE, errno.ESTALE),
)


def explain_file_error(error: OSError) -> UserError | None:
    """Explain a file-system error; None if a user cannot correct it."""
    if error.errno not in _OF_FILES:
        return None
    return UserError(
        str(error.filename or "a file"),
        f"could not be written or read ({error.strerror})",
        "Check its name, its folder and the free disk space.",
    )


def without_folders(text: str) -> str:
    """Shorten each absolute path in a text to its last part."""
    home = os.path.expanduser("~")  # Path.home() fails for users without one
    if home != "/":  # its last part is the user's name, which may contain spaces
        text = re.sub(re.escape(home) + r"(?![\w.-])", "~", text)
    return re.sub(r"(?<![\w/.~-])[~.]*/(?!/)\S*/", "", text)


# Set when Ctrl-C is pressed after :func:`no_lost_interrupts` has begun.
_heard = threading.Event()


def is_interrupt(error: BaseException | None) -> bool:
    """Whether Ctrl-C caused an error.

    Inside a loop, Dr.Jit raises another error from it; C++ libraries raise others in its place.
    """
    if _heard.is_set() and not isinstance(error, UserError):
        return True
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Defer Ctrl-C until the block ends: for values that have to change together."""
    before = signal.getsignal(signal.SIGINT)
    # Only the main thread receives signals, and a handler not set by Python is left as it is.
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


@contextmanager
def no_lost_interrupts() -> Iterator[None]:
    """Repeat a Ctrl-C that arrives in a destructor, where Python drops every exception, and
    remember one that becomes another error (:func:`is_interrupt`)."""
    before, raises = sys.unraisablehook, signal.getsignal(signal.SIGINT)

    def come_again(dropped: sys.UnraisableHookArgs) -> None:
        if not issubclass(dropped.exc_type, KeyboardInterrupt):
            before(dropped)
            return
        # From another thread and a moment later: raised here, it would be dropped too.
        again = threading.Timer(0.01, os.kill, (os.getpid(), signal.SIGINT))
        again.daemon = True
        again.start()

    def note(*arguments: Any) -> None:
        _heard.set()
        assert callable(raises)
        raises(*arguments)

    hears = threading.current_thread() is threading.main_thread() and callable(raises)
    sys.unraisablehook = come_again
    if hears:
        signal.signal(signal.SIGINT, note)
    try:
        yield
    finally:
        sys.unraisablehook = before
        if hears:
            signal.signal(signal.SIGINT, raises)
        _heard.clear()

"""Errors that a user can cause: they say where, what arrived and what to do."""

from __future__ import annotations

from pathlib import Path
from typing import Any


class UserError(Exception):
    """Something outside the program is wrong, and the user can mend it.

    The command line prints it without a traceback and exits with code 2;
    library callers catch it like any exception.

    Parameters
    ----------
    where: the file, key or object that is at fault, e.g. ``params.yaml: field.k``.
    what: what arrived, e.g. ``-1 is not >= 1``.
    todo: what the user can do about it, in the imperative.
    """

    exit_code = 2

    def __init__(self, where: str, what: str, todo: str) -> None:
        self.where, self.what, self.todo = where, what, todo
        super().__init__(f"{where}: {what}. {todo}")

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.where, self.what, self.todo)


class FileError(UserError):
    """A file that is missing, damaged or not what was expected.

    A program that knows what makes the file can name the command: :mod:`stages.common.makers` does.

    Parameters
    ----------
    path: the file.
    missing: whether there is no such file.
    """

    def __init__(self, path: Path, what: str, missing: bool = False) -> None:
        self.path, self.missing = Path(path), missing
        super().__init__(
            str(path), what, "Check the path." if missing else "Delete it and make it again."
        )

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.path, self.what, self.missing)

"""The one error that a user can cause: it says where, what arrived and what to do."""

from __future__ import annotations


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

    def __reduce__(self) -> tuple[type[UserError], tuple[str, str, str]]:
        return type(self), (self.where, self.what, self.todo)

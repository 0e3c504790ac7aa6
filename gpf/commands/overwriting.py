"""What exists is replaced only if the user asks for it."""

from __future__ import annotations

from pathlib import Path

from gpf.core.errors import UserError


def require_new(path: Path, overwrite: bool, otherwise: str = "choose another name") -> None:
    """Raise a :class:`UserError` if a file exists and may not be overwritten.

    ``otherwise``: what the user can do instead of adding ``--overwrite``.
    """
    if path.is_file() and not overwrite:
        raise _exists(path, otherwise)


def require_new_folder(folder: Path, part: str, overwrite: bool) -> None:
    """Raise a :class:`UserError` if a folder exists and may not be replaced.

    ``part``: a file that the command writes into such folders; without it, a folder may be the
    user's own work, and is never replaced.
    """
    if folder.exists() and not overwrite:
        raise _exists(folder, "choose another name")
    if folder.exists() and not (folder / part).is_file():
        what = f"has no {part}: it was not written by this command, so it is not replaced"
        raise UserError(str(folder), what, "Choose another name, or remove it yourself.")


def _exists(path: Path, otherwise: str) -> UserError:
    todo = f"Add --overwrite to replace it, or {otherwise}."
    return UserError(str(path), "already exists", todo)

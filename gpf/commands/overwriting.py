"""What exists is replaced only if the user asks for it."""

from __future__ import annotations

from pathlib import Path

from gpf.core.errors import UserError


def require_new(path: Path, overwrite: bool, otherwise: str = "choose another name") -> None:
    """Raise a :class:`UserError` if a file or folder exists and may not be overwritten.

    ``otherwise``: what the user can do instead of adding ``--overwrite``.
    """
    if path.exists() and not overwrite:
        todo = f"Add --overwrite to replace it, or {otherwise}."
        raise UserError(str(path), "already exists", todo)


def require_own(folder: Path, part: str) -> None:
    """Raise a :class:`UserError` if a folder that would be replaced lacks ``part``, a file that
    this program writes into such folders: it may be the user's own work."""
    if folder.exists() and not (folder / part).is_file():
        what = f"has no {part}: it was not written by this command, so it is not replaced"
        raise UserError(str(folder), what, "Choose another name, or remove it yourself.")

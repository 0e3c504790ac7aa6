"""What exists is replaced only if the user asks for it."""

from __future__ import annotations

from pathlib import Path

from gpf.core.errors import UserError


def require_new(path: Path, overwrite: bool, otherwise: str = "choose another name") -> None:
    """Raise a :class:`UserError` if a file exists and may not be overwritten.

    ``otherwise``: what the user can do instead of adding ``--overwrite``.
    """
    if path.is_file() and not overwrite:
        todo = f"Add --overwrite to replace it, or {otherwise}."
        raise UserError(str(path), "already exists", todo)

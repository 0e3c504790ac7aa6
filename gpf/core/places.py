"""Keep files with names chosen by others inside a folder, at every step of their paths."""

from __future__ import annotations

from itertools import accumulate
from pathlib import Path, PurePath

from gpf.core.errors import UserError


def place_below(folder: Path, name: str | PurePath, where: str) -> Path:
    """``folder / name``, with ``..`` and links below the folder resolved.

    ``where`` is the place that gives the name, for messages.

    Raises
    ------
    UserError: the path leaves the folder, even if it returns by the folder's own name: in a copy,
        it would lead elsewhere.
    """
    home, place = folder.resolve(), (folder / name).resolve()
    steps = accumulate(-1 if part == ".." else 1 for part in PurePath(name).parts)
    if min(steps, default=0) < 0 or not place.is_relative_to(home):
        raise UserError(
            where,
            f"refers to {name}, a path that leads out of the folder",
            "Copy the file into the folder and use a path that stays inside it.",
        )
    return folder / place.relative_to(home)


def make_place(folder: Path, name: str | PurePath, where: str) -> Path:
    """:func:`place_below`, with all folders along the path created."""
    place = place_below(folder, name, where)
    # Also those that the path only passes through: `a/../b` is not found without `a`.
    (folder / name).parent.mkdir(parents=True, exist_ok=True)
    return place

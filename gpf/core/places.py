"""Where files go whose names others have chosen: below a folder, on the whole way."""

from __future__ import annotations

from itertools import accumulate
from pathlib import Path, PurePath

from gpf.core.errors import UserError


def place_below(folder: Path, name: str | PurePath, where: str) -> Path:
    """``folder / name`` without ``..`` and links below the folder.

    ``where`` has the name, for the message.

    Raises
    ------
    UserError: the way leads out of the folder, even if it comes back in: by the folder's own name,
        it leads elsewhere from a copy.
    """
    home, place = folder.resolve(), (folder / name).resolve()
    steps = accumulate(-1 if part == ".." else 1 for part in PurePath(name).parts)
    if min(steps, default=0) < 0 or not place.is_relative_to(home):
        raise UserError(
            where,
            f"refers to {name}, a way that leads out of the folder",
            "Copy the file into the folder, and name it without leaving the folder.",
        )
    return folder / place.relative_to(home)


def make_place(folder: Path, name: str | PurePath, where: str) -> Path:
    """:func:`place_below`, and all folders on the way to it are made."""
    place = place_below(folder, name, where)
    # Also those that the way only passes through: `a/../b` is not found without `a`.
    (folder / name).parent.mkdir(parents=True, exist_ok=True)
    return place

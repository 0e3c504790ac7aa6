"""Files that belong together: all of them appear, whenever the program is killed, or none."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

from gpf.core.errors import UserError

# Names of the folders in which files wait: while they are written, and once all are.
_BEGUN, _READY = "begun", "ready"


def make_ready(workshop: Path, write: Callable[[Path], None]) -> None:
    """Let ``write`` fill a folder with files, all of which :func:`settle` will move or none."""
    begun = workshop / _BEGUN
    shutil.rmtree(begun, ignore_errors=True)
    try:
        begun.mkdir(parents=True)
    except OSError as error:
        raise UserError(
            str(begun),
            f"could not be made ({error})",
            "Free some disk space or check the folder.",
        ) from error
    try:
        write(begun)
    except BaseException:
        shutil.rmtree(begun, ignore_errors=True)
        raise
    os.replace(begun, workshop / _READY)


def settle(workshop: Path, target: Path) -> None:
    """Move files that are ready, of a run that was killed before it could, below ``target``."""
    ready = workshop / _READY
    if not ready.is_dir():
        return
    for path in sorted(p for p in ready.rglob("*") if p.is_file()):
        place = target / path.relative_to(ready)
        place.parent.mkdir(parents=True, exist_ok=True)
        os.replace(path, place)
    shutil.rmtree(ready)
    for folder in (workshop, workshop.parent):
        if not any(folder.iterdir()):
            folder.rmdir()

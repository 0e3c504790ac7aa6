"""Files that belong together: all or none of them appear, even if the program is killed."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

from gpf.core.errors import WriteError

# Folders of files that are being written, and of files that are complete.
_BEGUN, _READY = "begun", "ready"


def prepare_files(workshop: Path, write: Callable[[Path], None]) -> None:
    """Let ``write`` fill a folder below ``workshop``; :func:`publish_files` moves its files.

    Raises
    ------
    WriteError: the folder could not be made. If ``write`` raises an error, nothing is kept.
    """
    begun = workshop / _BEGUN
    shutil.rmtree(begun, ignore_errors=True)
    try:
        begun.mkdir(parents=True)
    except OSError as error:
        raise WriteError(begun, error) from error
    try:
        write(begun)
    except BaseException:
        shutil.rmtree(begun, ignore_errors=True)
        raise
    os.replace(begun, workshop / _READY)


def publish_files(workshop: Path, target: Path) -> None:
    """Move prepared files below ``target``; if this is interrupted, the next call resumes it.

    Anything else in the workshop was only needed to make them, and is removed.
    """
    ready = workshop / _READY
    if not ready.is_dir():
        return
    for path in workshop.iterdir():
        if path != ready:
            shutil.rmtree(path) if path.is_dir() else path.unlink()
    for path in sorted(p for p in ready.rglob("*") if p.is_file()):
        place = target / path.relative_to(ready)
        place.parent.mkdir(parents=True, exist_ok=True)
        os.replace(path, place)
    shutil.rmtree(ready)
    for folder in (workshop, workshop.parent):
        if not any(folder.iterdir()):
            folder.rmdir()

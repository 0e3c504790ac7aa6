"""Files and folders that are still being written, and those that killed runs have left behind.

They are called ``.gpf-partial-NAME-…``, and the process that writes one locks it. The lock ends
with the process, so an unlocked one is left over from a killed run.
"""

from __future__ import annotations

import ctypes
import errno
import fcntl
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

PREFIX = ".gpf-partial-"

_AT_FDCWD, _RENAME_EXCHANGE = -100, 2

# Reading the umask means setting it, for all threads.
_UMASK = os.umask(0o077)
os.umask(_UMASK)


@contextmanager
def partial_file(path: Path) -> Iterator[Path]:
    """A new empty file beside ``path``, removed at the end unless it was renamed."""

    def make() -> str:
        # The same suffix as the file: some writers choose the format by it.
        prefix = f"{PREFIX}{path.stem}-"
        handle, name = tempfile.mkstemp(path.suffix, prefix, path.parent)
        os.close(handle)
        return name

    with _locked(make) as file:
        yield file


@contextmanager
def partial_folder(path: Path) -> Iterator[Path]:
    """A new empty folder beside ``path``, removed at the end unless it was renamed."""
    prefix = f"{PREFIX}{path.name}-"
    with _locked(lambda: tempfile.mkdtemp(prefix=prefix, dir=path.parent)) as folder:
        yield folder


@contextmanager
def _locked(make: Callable[[], str]) -> Iterator[Path]:
    """The file or folder that ``make`` makes, locked; it is made again if another run removes it
    as a leftover before it is locked."""
    while True:
        path = Path(make())
        with suppress(FileNotFoundError):
            handle = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
            with suppress(OSError):  # a file system without locks
                fcntl.flock(handle, fcntl.LOCK_EX)  # waits for whoever is removing it
            if path.exists():
                break
            os.close(handle)
    try:
        yield path
    finally:
        _remove(path)
        os.close(handle)


def _remove(path: Path) -> None:
    shutil.rmtree(path, ignore_errors=True) if path.is_dir() else path.unlink(missing_ok=True)


def remove_leftovers(folder: Path, deep: bool = False) -> None:
    """Remove the half-written files and folders that killed runs have left in a folder.

    ``deep``: also in its subfolders.
    """
    found = folder.rglob(f"{PREFIX}*") if deep else folder.glob(f"{PREFIX}*")
    for path in list(found):
        with suppress(OSError):  # no permission, or gone in the meantime
            handle = os.open(path, os.O_RDONLY)
            try:
                if _try_to_lock(handle):
                    _remove(path)
            finally:
                os.close(handle)


def grant_as_usual(path: Path) -> None:
    """Give a new file or folder the user's usual permissions, as set by ``umask``.

    Temporary files are private to their user.
    """
    path.chmod((0o777 if path.is_dir() else 0o666) & ~_UMASK)


def replace_folder(new: Path, target: Path) -> None:
    """Replace a folder with another one.

    Where the file system can swap two folders atomically, a kill at any moment leaves either the
    old one or the new one.
    """
    if not target.exists():
        os.replace(new, target)
        return
    exchange = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", lambda *_: -1)
    paths = os.fsencode(new), os.fsencode(target)
    if exchange(_AT_FDCWD, paths[0], _AT_FDCWD, paths[1], _RENAME_EXCHANGE) == 0:
        _remove(new)
    else:
        shutil.rmtree(target)
        os.replace(new, target)


def _try_to_lock(handle: int) -> bool:
    """Lock a file unless another process has; return whether that worked."""
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        # Some network file systems have no locks: there, nothing can be known to be a leftover.
        return error.errno not in (errno.EWOULDBLOCK, errno.EACCES, errno.ENOLCK, errno.ENOTSUP)
    return True

"""Only one run at a time per output: a second one is told who holds the lock."""

from __future__ import annotations

import errno
import fcntl
import os
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from gpf.core.errors import UserError, WriteError

# Errors of file systems without locks, such as some network file systems.
_NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.ENOSYS)


@contextmanager
def sole_run(output: Path, shared: bool = False, inside: bool = False) -> Iterator[None]:
    """Hold the lock of an output, in the file ``.lock-NAME`` beside it.

    The system releases the lock when the process ends, so a killed run blocks nobody.

    Parameters
    ----------
    output: file or folder that the run writes; it need not exist.
    shared: whether other shared runs may work at the same time.
    inside: whether to put the lock file inside the output, a folder: the user may be allowed to
        write there, but not beside it.

    Raises
    ------
    UserError: another run holds the lock.
    WriteError: the folder cannot be written.
    """
    file = output / ".lock-run" if inside else output.parent / f".lock-{output.name}"
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        handle = _lock(file, fcntl.LOCK_SH if shared else fcntl.LOCK_EX)
    except BlockingIOError as error:
        raise UserError(
            str(output), f"is being made by {_holder(file)}", "Wait until it finishes, or stop it."
        ) from error
    except OSError as error:
        raise WriteError(file, error) from error
    try:
        yield
    finally:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            file.unlink(missing_ok=True)
        except OSError:  # others share it
            pass
        os.close(handle)


def _lock(file: Path, kind: int) -> int:
    """Lock the file and write a description of this process to it; return its handle."""
    while True:
        handle = os.open(file, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            fcntl.flock(handle, kind | fcntl.LOCK_NB)
            if os.fstat(handle).st_nlink == 0:  # removed by the previous run between the two calls
                os.close(handle)
                continue
        except OSError as error:
            if error.errno not in _NO_LOCKS:
                os.close(handle)
                raise
        since = time.strftime("%Y-%m-%d %H:%M:%S")
        os.truncate(handle, 0)
        os.write(handle, f"process {os.getpid()} on {socket.gethostname()} since {since}".encode())
        return handle


def _holder(file: Path) -> str:
    """A description of who holds the lock."""
    try:
        return file.read_text(encoding="utf-8", errors="replace") or "another run"
    except OSError:
        return "another run"

"""A process that has imported everything, and forks for each run of the command line.

A run is a process of its own that signals can end, and it starts at once. Orders and endings are
lines of JSON; ``tests/faults/runner.py`` writes and reads them.
"""

from __future__ import annotations

import ctypes
import importlib
import json
import mmap
import os
import resource
import signal
import struct
import sys
import time
import traceback
from threading import Thread
from typing import Any

import drjit as dr
import pytest

DAY = 86400.0
OF_FILES = ("os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.truncate")


def serve() -> None:
    """Run what the orders on standard input say, one after the other."""
    import torch

    from gpf.cli import main  # no variant yet: Dr.Jit starts in the forked processes
    from stages.commands.stage import STAGES

    torch.set_num_threads(1)
    for module in ("gpf.commands.fit", "gpf.commands.render", "metrics.lpips"):
        importlib.import_module(module)
    for stage in STAGES:
        importlib.import_module(f"stages.{stage}")
    answers = os.fdopen(os.dup(1), "w")
    for line in sys.stdin:
        print(json.dumps(run(main, **json.loads(line))), file=answers, flush=True)


def run(
    main: Any, folder: str, arguments: list[str], small: bool, fault: dict[str, Any]
) -> dict[str, Any]:
    """One run: its exit code (negative: the signal), what it said, and its changes of files."""
    changes = mmap.mmap(-1, 8)  # shared with the forked process
    hear, say = os.pipe()  # not a file, whose size a fault may limit
    process = os.fork()
    if process == 0:
        os._exit(_child(main, folder, arguments, say, small, fault, changes))
    os.close(say)
    said: list[bytes] = []
    listener = Thread(target=lambda: said.extend(iter(lambda: os.read(hear, 65536), b"")))
    listener.start()
    _, status = os.waitpid(process, 0)
    listener.join()
    os.close(hear)
    return {
        "code": os.waitstatus_to_exitcode(status),
        "said": " ".join(b"".join(said).decode(errors="replace").split()),
        "changes": int.from_bytes(changes[:8], "little"),
    }


def _child(
    main: Any,
    folder: str,
    arguments: list[str],
    say: int,
    small: bool,
    fault: dict[str, Any],
    changes: mmap.mmap,
) -> int:
    """In the forked process: prepare the fault and run; returns the exit code."""
    os.dup2(say, 1)
    os.dup2(say, 2)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.chdir(folder)
    dr.set_thread_count(1)  # the order of threads changes sums of floats
    signal.signal(signal.SIGINT, signal.default_int_handler)
    if small:
        from tests.small_fit import make_small

        make_small(pytest.MonkeyPatch(), passes=6, steps=20, paths=5_000)
    if fault["file_size"] is not None:
        limit = fault["file_size"], resource.RLIM_INFINITY
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
    if fault["clock"]:
        _let_the_clock_jump()
    if fault["unprivileged"]:
        _drop_capabilities()
    sys.addaudithook(_counter(changes, fault["signals"], fault["before_change"]))
    try:
        main(arguments)
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
    except BaseException:
        traceback.print_exc()
        code = 1
    sys.stdout.flush()
    sys.stderr.flush()
    return code


def _drop_capabilities() -> None:
    """Without them, root may do with a file what its permissions say."""
    version_3, this_process = 0x20080522, 0
    header, nothing = struct.pack("<Ii", version_3, this_process), bytes(24)
    if ctypes.CDLL(None, use_errno=True).capset(header, nothing):
        raise OSError(ctypes.get_errno(), "capset")


def _let_the_clock_jump() -> None:
    """Each look at the clock is a day before or after the one before."""
    clock, looks = time.time, []

    def jumping() -> float:
        looks.append(1)
        return clock() + (DAY if len(looks) % 2 else -DAY)

    time.time = jumping


def _counter(changes: mmap.mmap, signals: list[int], first: int) -> Any:
    """A hook that counts changes of files below the working directory, and sends this process the
    signals, one before each change from number ``first`` on."""
    here = os.getcwd()

    def count(event: str, details: tuple[Any, ...]) -> None:
        if event == "open":
            if not isinstance(details[2], int) or not details[2] & (os.O_WRONLY | os.O_RDWR):
                return
        elif event not in OF_FILES:
            return
        path = os.fsdecode(details[0]) if isinstance(details[0], str | bytes | os.PathLike) else ""
        if path.startswith("/") and not path.startswith(here):
            return
        seen = int.from_bytes(changes[:8], "little") + 1
        changes[:8] = seen.to_bytes(8, "little")
        if 0 <= seen - first < len(signals):
            os.kill(os.getpid(), signals[seen - first])

    return count


if __name__ == "__main__":
    serve()

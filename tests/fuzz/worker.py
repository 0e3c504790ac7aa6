"""A process that runs cases one after the other, with limits, and says how each of them ends.

Run as `python -m tests.fuzz.worker KIND SEED FIRST LAST FOLDER PIPE`; the runner starts it.
"""

from __future__ import annotations

import contextlib
import faulthandler
import gc
import io
import json
import os
import resource
import shutil
import sys
import tempfile
import traceback
from collections.abc import Iterator
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

from tests.fuzz.case import Case, random_of

MEMORY, CPU_SECONDS = 6 * 2**30, 3600
"""Limits of a worker: addresses in bytes, and time of all cores."""

_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
_CHANGES = {"os.mkdir": 1, "os.rename": 2, "os.remove": 1, "os.rmdir": 1, "os.symlink": 2}
_CHANGES |= {"os.link": 2, "os.truncate": 1, "os.chmod": 1, "os.utime": 1, "shutil.rmtree": 1}


class Watch:
    """Notes what Python code changes outside of a folder."""

    def __init__(self) -> None:
        self.folder: Path | None = None
        self.outside: list[str] = []
        sys.addaudithook(self._hear)

    def _hear(self, event: str, arguments: tuple[Any, ...]) -> None:
        if self.folder is None:
            return
        paths: tuple[Any, ...] = ()
        if event == "open":
            path, mode, flags = arguments
            writes = any(c in mode for c in "wax+") if isinstance(mode, str) else flags & _WRITING
            paths = (path,) if writes else ()
        elif event in _CHANGES:
            paths = arguments[: _CHANGES[event]]
        for path in paths:
            if isinstance(path, str | bytes | os.PathLike):
                place = os.path.realpath(os.fsdecode(path))
                if place != "/dev/null" and not place.startswith(f"{self.folder}{os.sep}"):
                    self.outside.append(f"{event} {place}")


def files_of(folder: Path) -> dict[str, tuple[int, int]]:
    """Size and time of change of all files below a folder."""
    found = {}
    for path in folder.rglob("*"):
        if not path.is_dir():
            status = path.lstat()
            found[path.relative_to(folder).as_posix()] = (status.st_size, status.st_mtime_ns)
    return found


def judge(case: Case, code: object, text: str, changed: set[str]) -> tuple[str, str]:
    """The outcome of a case, and what was said or found."""
    stray = [name for name in sorted(changed) if not any(fnmatch(name, p) for p in case.writes)]
    if stray:
        return "outside", ", ".join(stray)
    if "Traceback" in text:
        return "traceback", text
    if code == 0:
        return "worked", ""
    if code != 2:
        return "exit code", f"{code}: {text}"
    if "Usage:" in text or "─ Error ─" in text:  # of the command line itself
        return "refused", text
    message = text[text.find("error: ") :]
    known = [word for word in case.words if word.startswith("-") or "." in word] + [*case.names]
    if text.count("error: ") < 1 or not any(name in message for name in known):
        return "unnamed", text
    return "refused", message


def run_case(case: Case, folder: Path, watch: Watch) -> tuple[str, str]:
    """Run a command line in the folder of its files."""
    from gpf.cli import main

    target, text = folder / "target", io.StringIO()
    before, code = files_of(target), 0
    watch.outside, watch.folder = [], folder
    try:
        with (
            contextlib.chdir(target),
            contextlib.redirect_stdout(text),
            contextlib.redirect_stderr(text),
        ):
            main(case.words)
    except SystemExit as error:
        code = error.code or 0  # type: ignore[assignment]
    except BaseException:  # no error at all may leave the command line
        return "traceback", traceback.format_exc(limit=-7)
    finally:
        watch.folder = None
    after = files_of(target)
    changed = {name for name in after.keys() | before.keys() if after.get(name) != before.get(name)}
    if watch.outside:
        return "outside", ", ".join(watch.outside)
    return judge(case, code, " ".join(text.getvalue().split()), changed)


@contextlib.contextmanager
def place_of(number: int, root: Path) -> Iterator[Path]:
    """The folder of a case, with its own folder for temporary files; removed afterwards."""
    folder = root / str(number)
    shutil.rmtree(folder, ignore_errors=True)
    (folder / "target").mkdir(parents=True)
    (folder / "temporary").mkdir()
    tempfile.tempdir = str(folder / "temporary")
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def work(kind: str, seed: int, numbers: range, root: Path, pipe: int) -> None:
    """Run cases; a line of JSON goes into the pipe before and after each."""
    from tests.fuzz import shortcuts
    from tests.fuzz.kinds import KINDS

    shortcuts.take()
    watch, good = Watch(), root / "good"

    def tell(**facts: Any) -> None:
        os.write(pipe, json.dumps(facts).encode() + b"\n")

    tell(ready=True)
    for number in numbers:
        with place_of(number, root) as folder:
            case = KINDS[kind](random_of(seed, kind, number), folder / "target", good)
            tell(number=number, words=case.words)
            outcome, what = run_case(case, folder.resolve(), watch)
            gc.collect()  # what is left of a scene would be traced with the next
        tell(number=number, outcome=outcome, what=what[-3000:])


def main() -> None:
    """Read the arguments, set the limits, make the good files, and work."""
    kind, seed, first, last, root, pipe = sys.argv[1:]
    faulthandler.enable()
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CPU, (CPU_SECONDS, CPU_SECONDS))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    from gpf.core.runtime import choose_variant
    from tests.fuzz.good import make_good_files

    choose_variant("auto")
    if not (Path(root) / "good").exists():
        make_good_files(Path(root) / "good")
    work(kind, int(seed), range(int(first), int(last)), Path(root).resolve(), int(pipe))


if __name__ == "__main__":
    main()

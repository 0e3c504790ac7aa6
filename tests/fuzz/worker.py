"""What a worker process does: it runs a case, within limits, and says how it ends."""

from __future__ import annotations

import contextlib
import faulthandler
import gc
import io
import os
import resource
import sys
import tempfile
import traceback
import webbrowser
from collections.abc import Iterator
from fnmatch import fnmatch
from functools import cache, partial
from pathlib import Path
from typing import Any

import pytest

from tests.fuzz.case import Case

GOOD = ("worked", "refused")
"""How a case may end, beside "traceback", "exit code", "unnamed", "outside", "hang" and "crash"."""

Outcome = tuple[str, str]
"""How a case ended, and what was said or found."""

LIMITS = {
    resource.RLIMIT_AS: 6 * 2**30,  # bytes of addresses
    resource.RLIMIT_FSIZE: 2**30,  # bytes of a file
    resource.RLIMIT_CPU: 3600,  # seconds of all cores
    resource.RLIMIT_CORE: 0,
}
_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
_CHANGES = {"os.mkdir": 1, "os.rename": 2, "os.remove": 1, "os.rmdir": 1, "os.symlink": 2}
_CHANGES |= {"os.link": 2, "os.truncate": 1, "os.chmod": 1, "os.utime": 1, "shutil.rmtree": 1}


class Watch:
    """Notes what Python code changes outside of a folder, while it has one."""

    def __init__(self) -> None:
        self.folder: Path | None = None
        self.outside: list[str] = []
        sys.addaudithook(self._hear)

    @contextlib.contextmanager
    def over(self, folder: Path) -> Iterator[list[str]]:
        """What is changed outside of this folder."""
        self.folder, self.outside = folder, []
        try:
            yield self.outside
        finally:
            self.folder = None

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


@cache
def the_watch() -> Watch:
    """The only one of this process: it hears for ever."""
    return Watch()


def write_files(case: Case, folder: Path) -> None:
    """Write a case's files."""
    for name, content in case.files.items():
        place = folder / name
        place.parent.mkdir(parents=True, exist_ok=True)
        if content is None:
            place.mkdir()
        elif isinstance(content, Path):
            place.symlink_to(content)
        else:
            place.write_bytes(content)


def files_of(folder: Path) -> dict[str, tuple[int, int]]:
    """Size and time of change of all files below a folder."""
    found = {}
    for path in folder.rglob("*"):
        if not path.is_dir():
            status = path.lstat()
            found[path.relative_to(folder).as_posix()] = (status.st_size, status.st_mtime_ns)
    return found


def judge(case: Case, code: object, text: str, changed: set[str]) -> Outcome:
    """The outcome of a case."""
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


def run_case(case: Case, folder: Path) -> Outcome:
    """Run a command line in the new folder of its files."""
    from gpf.cli import main

    target, text = folder / "target", io.StringIO()
    target.mkdir(parents=True)
    (folder / "temporary").mkdir()
    tempfile.tempdir = str(folder / "temporary")
    write_files(case, target)
    before, code = files_of(target), 0
    gc.collect()  # what is left of the last scene would be traced with this one
    try:
        with (
            contextlib.chdir(target),
            contextlib.redirect_stdout(text),
            contextlib.redirect_stderr(text),
            the_watch().over(folder) as outside,
        ):
            main(case.words)
    except SystemExit as error:
        code = error.code or 0  # type: ignore[assignment]
    except BaseException:  # no error at all may leave the command line
        return "traceback", traceback.format_exc(limit=-7)
    after = files_of(target)
    changed = {name for name in after.keys() | before.keys() if after.get(name) != before.get(name)}
    if outside:
        return "outside", ", ".join(outside)
    return judge(case, code, " ".join(text.getvalue().split()), changed)


def take_shortcuts() -> None:
    """Make sizes and waiting shorter, so that a case takes a part of a second."""
    from gpf.viewing import viewer
    from stages.commands import scene_import
    from stages.importing import importer
    from tests.small_fit import make_small
    from tests.stages.importing.foreign_scene import place_two

    few = partial(importer.import_scene, photons=500)
    scene_import.import_scene = few  # type: ignore[assignment]
    scene_import.place_views = place_two
    # A page that is served until Ctrl-C: it starts, and that is all.
    viewer.Viewer.run = lambda viewer: None  # type: ignore[method-assign]
    webbrowser.open = lambda *_, **__: True  # type: ignore[assignment]
    make_small(pytest.MonkeyPatch(), passes=2, steps=4, paths=2000)


def begin(log: Path) -> None:
    """Set the limits of this process, and send what it prints to a file."""
    with log.open("wb") as stream:
        os.dup2(stream.fileno(), 1)
        os.dup2(stream.fileno(), 2)
    faulthandler.enable()
    sys.dont_write_bytecode = True
    os.environ |= {"COLUMNS": "500", "GPF_SCENES": ""}  # messages in one line
    for limit, most in LIMITS.items():
        resource.setrlimit(limit, (most, most))
    from gpf.core.runtime import choose_variant

    choose_variant("auto")
    take_shortcuts()

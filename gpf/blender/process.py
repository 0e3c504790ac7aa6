"""Blender in a process of its own: where it is, what it says, and when it must stop."""

from __future__ import annotations

import ctypes
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import platformdirs

from gpf.core.errors import UserError

VARIABLE = "GPF_BLENDER"

LIMIT = 3600.0
"""Seconds that Blender may take between two words of what it does."""

PYTHON_FAILED = 3
"""Exit code of Blender after an exception in a script; of Python with the package ``bpy``, 1."""

PROGRAMS = Path(__file__).parent / "program"

PACKAGES = {(3, 11): "bpy==5.0.1", (3, 13): "bpy==5.1.2"}
"""Blender as a Python package, by the version of Python that it needs."""

OLDEST = (4, 5)
"""The first version of Blender that has all operators that the programs use."""


def installed_python() -> Path:
    """The Python of the environment that `gpf blender-install` makes."""
    return platformdirs.user_cache_path("gpf") / "blender" / "bin" / "python"


def find_blender() -> list[str]:
    """The command that runs a script in Blender, up to the script's path.

    What the variable ``GPF_BLENDER`` names: a ``blender`` executable, or a Python with the package
    ``bpy``. Without it, the first of these that is not older than :data:`OLDEST`: the environment
    of `gpf blender-install`, this Python, and ``blender`` on the path.

    Raises
    ------
    UserError: there is none.
    """
    named = os.environ.get(VARIABLE)
    programs = [named] if named else [str(installed_python()), sys.executable, "blender"]
    where, what = f"{VARIABLE}={named}", "is neither Blender nor a Python with bpy"
    if not named:
        where, what = "Blender", "is not installed: it reads .blend, .glb, .usd, .fbx, .obj files"
    for program in filter(None, map(shutil.which, programs)):
        version = version_of(_command(program))
        if version >= OLDEST:
            return _command(program)
        if version:
            what = f"must be {_dotted(OLDEST)} or later: {program} is {_dotted(version)}"
    todo = f"Run `gpf blender-install` (400 MB), or set {VARIABLE} to a blender executable."
    raise UserError(where, what, todo)


def version_of(command: Sequence[str]) -> tuple[int, ...]:
    """The version of Blender that a command of :func:`find_blender` runs; empty if it runs none."""
    asked = [command[0], "--version"]
    if "--python" not in command:
        told = "from importlib.metadata import version; print('Blender', version('bpy'))"
        asked = [*command, "-c", told]
    said = subprocess.run(asked, capture_output=True, text=True, errors="replace", check=False)
    found = re.search(r"^Blender (\d+)\.(\d+)", said.stdout, re.MULTILINE)
    return tuple(map(int, found.groups())) if found else ()


def _dotted(version: Sequence[int]) -> str:
    return ".".join(map(str, version))


def _command(program: str) -> list[str]:
    if Path(program).name.startswith("python"):
        return [program, "-I"]
    # No start-up file and no scripts of the user, and none of the scene's.
    quiet = ["--background", "--factory-startup", "--disable-autoexec", "--offline-mode"]
    return [program, *quiet, "--python-exit-code", str(PYTHON_FAILED), "--python"]


def read_with_blender(
    file: Path, folder: Path, tell: Callable[[str], None], frames: str | None = None
) -> None:
    """Have Blender read a file and write what is in it into a new folder.

    ``frames``: those to read instead of the scene as it was saved (``program/read.py``).

    Raises
    ------
    UserError: as :func:`run_in_blender`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    words: list[Path | str] = [file.resolve(), folder.resolve()]
    if frames is not None:
        words.append(frames)
    result = folder / ("scene.json" if frames is None else "frames.json")
    run_in_blender("read.py", words, result, file, tell)


def run_in_blender(
    program: str,
    words: Sequence[Path | str],
    result: Path,
    subject: Path,
    tell: Callable[[str], None],
) -> None:
    """Run one of the scripts in ``program`` in Blender.

    Parameters
    ----------
    result: a file that it must write.
    subject: the file that messages are about.
    tell: gets what Blender is doing, one line after another.

    Raises
    ------
    UserError: Blender is missing, refuses the file, fails, or is silent for :data:`LIMIT`.
    """
    command = find_blender()
    separator = ["--"] if "--python" in command else []
    with (
        tempfile.TemporaryDirectory() as home,
        subprocess.Popen(
            [*command, str(PROGRAMS / program), *separator, *map(str, words)],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
            text=True,
            errors="replace",
            env=_environment(home),
            preexec_fn=partial(_prepare, os.getpid(), ctypes.CDLL(None)),
        ) as process,
    ):
        late = threading.Timer(LIMIT, process.kill)
        late.start()
        said: deque[str] = deque(maxlen=12)
        refused = ""
        try:
            assert process.stdout is not None
            for line in process.stdout:
                line = line.rstrip()
                if line.startswith("gpf: "):
                    late.cancel()
                    late = threading.Timer(LIMIT, process.kill)
                    late.start()
                    tell(line.removeprefix("gpf: "))
                elif line.startswith("gpf-error: "):
                    refused = line.removeprefix("gpf-error: ")
                elif line:
                    said.append(line)
            code = process.wait()
        finally:
            timed_out = late.finished.is_set()
            late.cancel()
            process.kill()
    if refused:
        todo = f"See if Blender opens it; {VARIABLE} may name another version."
        raise UserError(str(subject), refused, todo)
    if timed_out:
        raise UserError(str(subject), f"kept Blender busy for {LIMIT:.0f} s", "Simplify the scene.")
    if code != 0 or not result.is_file():
        what = f"made Blender fail (exit code {code}). Its last words:\n" + "\n".join(said)
        todo = "If memory was enough, open it in Blender and save it again."
        if code in (1, PYTHON_FAILED):
            todo = "The file may be right: report these words, or remove what they name."
        raise UserError(str(subject), f"{what}\n", todo)


def _environment(home: str) -> dict[str, str]:
    """Without add-ons and settings of the user, and without variables for this Python."""
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "BLENDER"))}
    return kept | {"BLENDER_USER_RESOURCES": home, "PYTHONNOUSERSITE": "1"}


def _prepare(parent: int, library: Any) -> None:
    """In the process that becomes Blender: it gets at most as much memory as the machine has, so
    that a scene does not stop everything else, and ends with the process that started it."""
    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    resource.setrlimit(resource.RLIMIT_DATA, (total, total))
    if sys.platform == "linux":
        set_death_signal = 1
        library.prctl(set_death_signal, signal.SIGKILL)
        if os.getppid() != parent:  # it had ended before
            os._exit(1)


def install(tell: Callable[[str], None]) -> Path:
    """Make an environment with Blender's Python package; its Python.

    Raises
    ------
    UserError: there is no Python that the package needs, or it cannot be installed.
    """
    target = installed_python().parent.parent
    versions = " or ".join(f"{a}.{b}" for a, b in PACKAGES)
    failed = UserError(
        "Blender's Python package",
        f"needs Python {versions}, which is not on the path",
        f"Install it, or set {VARIABLE} to a blender executable.",
    )
    for (major, minor), package in PACKAGES.items():
        name = f"python{major}.{minor}"
        python = sys.executable if sys.version_info[:2] == (major, minor) else shutil.which(name)
        if python is None:
            continue
        tell(f"{package} for Python {major}.{minor} into {target}")
        for step in (
            [python, "-m", "venv", "--clear", str(target)],
            [str(installed_python()), "-m", "pip", "install", "--no-compile", package],
            [str(installed_python()), "-I", "-c", "import bpy"],
        ):
            done = subprocess.run(step, capture_output=True, text=True, check=False)
            if done.returncode != 0:
                words = (done.stderr.strip() or done.stdout.strip()).splitlines()
                failed = UserError(
                    package,
                    f"could not be installed: {words[-1] if words else done.returncode}",
                    f"Check the network and libraries that are missing, or set {VARIABLE} to a "
                    "blender executable.",
                )
                break
        else:
            return installed_python()
    raise failed

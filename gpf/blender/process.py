"""Blender in a process of its own: where it is, what it says, and when it must stop."""

from __future__ import annotations

import importlib.util
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import threading
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path

import platformdirs

from gpf.core.errors import UserError

VARIABLE = "GPF_BLENDER"

LIMIT = 3600.0
"""Seconds that Blender may take between two words of what it does."""

PROGRAMS = Path(__file__).parent / "program"

PACKAGES = {(3, 11): "bpy==5.0.1", (3, 13): "bpy==5.1.2"}
"""Blender as a Python package, by the version of Python that it needs."""


def installed_python() -> Path:
    """The Python of the environment that `gpf blender-install` makes."""
    return platformdirs.user_cache_path("gpf") / "blender" / "bin" / "python"


def find_blender() -> list[str]:
    """The command that runs a script in Blender, up to the script's path.

    The first of: the variable ``GPF_BLENDER``, which names a ``blender`` executable or a Python
    with the package ``bpy``; ``blender`` on the path; the environment of `gpf blender-install`;
    this Python, if it has ``bpy``.

    Raises
    ------
    UserError: there is none.
    """
    if named := os.environ.get(VARIABLE):
        found = shutil.which(named)
        if found is None:
            raise UserError(
                f"{VARIABLE}={named}", "is not a program", "Name blender, or a Python with bpy."
            )
        return _command(found)
    if found := shutil.which("blender"):
        return _command(found)
    if installed_python().is_file():
        return [str(installed_python()), "-I"]
    if importlib.util.find_spec("bpy") is not None:
        return [sys.executable, "-I"]
    raise UserError(
        "Blender",
        "is not installed: it reads .blend, .glb, .usd, .fbx and .obj files",
        f"Run `gpf blender-install` (400 MB), or set {VARIABLE} to a blender executable.",
    )


def _command(program: str) -> list[str]:
    if Path(program).name.startswith("python"):
        return [program, "-I"]
    # No start-up file and no scripts of the user, and none of the scene's.
    quiet = ["--background", "--factory-startup", "--disable-autoexec", "--offline-mode"]
    return [program, *quiet, "--python-exit-code", "3", "--python"]


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
            preexec_fn=_limit_memory,
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
        raise UserError(str(subject), refused, "Open it in Blender and save it again.")
    if timed_out:
        raise UserError(str(subject), f"kept Blender busy for {LIMIT:.0f} s", "Simplify the scene.")
    if code != 0 or not result.is_file():
        last = "\n".join(said)
        raise UserError(
            str(subject),
            f"made Blender fail (exit code {code}). Its last words:\n{last}\n",
            "Open it in Blender and save it again.",
        )


def _environment(home: str) -> dict[str, str]:
    """Without add-ons and settings of the user, and without variables for this Python."""
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "BLENDER"))}
    return kept | {"BLENDER_USER_RESOURCES": home, "PYTHONNOUSERSITE": "1"}


def _limit_memory() -> None:
    """At most as much memory as the machine has: a scene must not stop everything else."""
    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    resource.setrlimit(resource.RLIMIT_DATA, (total, total))


def install(tell: Callable[[str], None]) -> Path:
    """Make an environment with Blender's Python package; its Python.

    Raises
    ------
    UserError: there is no Python that the package needs, or it cannot be installed.
    """
    target = installed_python().parent.parent
    for (major, minor), package in PACKAGES.items():
        python = shutil.which(f"python{major}.{minor}")
        if sys.version_info[:2] == (major, minor):
            python = sys.executable
        if python is None:
            continue
        tell(f"{package} for Python {major}.{minor} into {target}")
        steps = (
            [python, "-m", "venv", "--clear", str(target)],
            [str(installed_python()), "-m", "pip", "install", "--no-compile", package],
        )
        for step in steps:
            done = subprocess.run(step, capture_output=True, text=True, check=False)
            if done.returncode != 0:
                shutil.rmtree(target, ignore_errors=True)
                words = (done.stderr.strip() or done.stdout.strip()).splitlines()
                raise UserError(
                    package,
                    f"could not be installed: {words[-1] if words else done.returncode}",
                    f"Check the network, or set {VARIABLE} to a blender executable.",
                )
        return installed_python()
    versions = " or ".join(f"{a}.{b}" for a, b in PACKAGES)
    raise UserError(
        "Blender's Python package",
        f"needs Python {versions}, which is not on the path",
        f"Install it, or set {VARIABLE} to a blender executable.",
    )

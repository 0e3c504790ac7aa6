"""What works on this machine, what is missing, and the command that mends it.

:func:`diagnose` looks, :func:`print_report` tells. Whatever could end a process (a kernel on an
unknown libLLVM, an import of compiled code) is tried in a process of its own, so that the
doctor outlives it. This is the one file of the library that looks at the whole project around
it: the lock file, the repository, the weights of the metrics.
"""

import importlib
import os
import platform
import re
import shlex
import shutil
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.text import Text

from gpf.core.runtime import (
    LLVM_INSTALL,
    LLVM_MINIMUM,
    LLVM_VARIABLE,
    count_cores,
    read_cpu_model,
    read_version,
)
from gpf.core.subprocesses import PROBE_SUM, last_line, run_probe, run_python

ROOT = Path(__file__).resolve().parents[1]
LOCK = ROOT / "requirements.lock"
LOCK_INSTALL = "pip install -r requirements.lock"

FREE_DISK_GIB = 2.0
"""What the default profile writes, DVC's cache included, with room to spare."""
MEMORY_GIB = 4.0
"""Below this the larger profiles may end in the system's out-of-memory killer."""


@dataclass(frozen=True)
class Check:
    """One line of the report. ``ok`` is ``None`` where something optional is missing."""

    name: str
    ok: bool | None
    detail: str
    remedy: str = ""
    """The command that mends it, or what to do where no command does."""


def diagnose() -> list[Check]:
    """Look at everything the project needs; takes a few seconds, changes nothing."""
    probe = run_probe()
    return [
        check_python(),
        *(check_locked(package) for package in ("mitsuba", "drjit")),
        check_cuda(probe),
        check_libllvm(probe),
        check_torch(),
        check_importable("OpenEXR", "OpenEXR"),
        check_repository(),
        check_lpips_weights(),
        check_flip(),
        *check_baselines(),
        check_disk(),
        check_memory(),
        Check("processor", True, f"{read_cpu_model()}, {count_cores()} cores for this process"),
    ]


def print_report(checks: Sequence[Check], console: Console | None = None) -> int:
    """Print one line per check with its remedy; return 0 if nothing required fails, else 1."""
    console = console or Console()
    words = {
        True: Text("ok   ", "green"),
        False: Text("FAILS", "bold red"),
        None: Text("note ", "yellow"),
    }
    for check in checks:
        line = Text.assemble(words[check.ok], f"  {check.name:<13}  {check.detail}")
        if check.ok is not True and check.remedy:
            line.append(f"\n       -> {spell_out(check.remedy)}", "bold")
        console.print(line, soft_wrap=True)  # whole lines: commands are there to be copied
    failed = [check.name for check in checks if check.ok is False]
    notes = [check.name for check in checks if check.ok is None]
    if failed:
        console.print(f"\nTo be mended: {', '.join(failed)}.", soft_wrap=True)
    else:
        optional = f" (optional: {', '.join(notes)})" if notes else ""
        console.print(f"\nAll that is required works{optional}.", soft_wrap=True)
    return 1 if failed else 0


def spell_out(remedy: str) -> str:
    """Turn ``pip`` and the lock file into the ones that belong to this interpreter and checkout.

    A bare ``pip`` would be the system's wherever the environment is not activated.
    """
    interpreter, lock = shlex.quote(_shorten(Path(sys.executable))), shlex.quote(_shorten(LOCK))
    remedy = re.sub(r"(?<![/\w])pip (?=(un)?install)", lambda _: f"{interpreter} -m pip ", remedy)
    return remedy.replace("requirements.lock", lock)


def check_python() -> Check:
    """3.11 or 3.12: what the lock file was resolved for."""
    ok = sys.version_info[:2] in ((3, 11), (3, 12))
    remedy = "rm -rf .venv && make venv PYTHON=python3.11"
    return Check("Python", ok, f"{platform.python_version()} at {sys.executable}", remedy)


def check_locked(package: str) -> Check:
    """Compare an installed version with the lock file, where there is one."""
    found, locked = read_version(package), read_lock().get(package.lower())
    if found is None:
        return Check(package, False, "not installed", LOCK_INSTALL)
    # A build of the same version (torch 2.13.0+cpu) is the same version.
    if locked is not None and found.partition("+")[0] != locked:
        return Check(package, False, f"{found}, but the lock file says {locked}", LOCK_INSTALL)
    return Check(package, True, found if locked else f"{found} (no lock file to compare with)")


def read_lock(path: Path | None = None) -> dict[str, str]:
    """Read the lock file as {package in lower case: version}; empty outside of a checkout."""
    path = path or LOCK
    if not path.is_file():
        return {}
    pairs = re.findall(r"^([\w.-]+)==([^\s;]+)", path.read_text(encoding="utf-8"), re.MULTILINE)
    return {name.lower(): version for name, version in pairs}


def check_libllvm(probe: dict[str, Any]) -> Check:
    """A libLLVM that is new enough and compiled a kernel; required unless CUDA works."""
    missing = None if probe.get("cuda_sum") == PROBE_SUM else False
    path = os.environ.get(LLVM_VARIABLE) or "found on the system"
    version = probe.get("llvm")
    if version is None:
        detail = f"the trial process ended before it could tell: {probe.get('died')}"
        return Check("libLLVM", missing, detail, LOCK_INSTALL)
    remedy = f"unset {LLVM_VARIABLE}; {LLVM_INSTALL}"
    if version[0] < 0:
        detail = f"none that Dr.Jit can use ({LLVM_VARIABLE}={os.environ.get(LLVM_VARIABLE, '')})"
        return Check("libLLVM", missing, detail, remedy)
    detail = f"{'.'.join(map(str, version))}, {path}"
    if version[0] < LLVM_MINIMUM:
        detail += f": older than {LLVM_MINIMUM}, it would end the process on the first render"
        return Check("libLLVM", missing, detail, remedy)
    if probe.get("llvm_sum") != PROBE_SUM:
        detail += f": a small kernel failed ({probe.get('died', 'wrong result')})"
        return Check("libLLVM", missing, detail, remedy)
    return Check("libLLVM", True, detail)


def check_cuda(probe: dict[str, Any]) -> Check:
    """A CUDA device that ran a kernel; without one the CPU does the work."""
    if probe.get("cuda_sum") == PROBE_SUM:
        return Check("CUDA", True, "a device that runs kernels: runtime.variant auto takes it")
    if "cuda" not in probe:
        return Check(
            "CUDA", None, "not known: the trial process ended before it could tell", LOCK_INSTALL
        )
    if not probe["cuda"]:
        remedy = "nothing to do; with an NVIDIA GPU: install its driver"
        return Check("CUDA", None, "no device: the CPU does the work", remedy)
    detail = f"a device, but a small kernel failed on it ({probe.get('died', 'wrong result')})"
    return Check("CUDA", False, detail, "set runtime.variant: llvm_ad_rgb in params.yaml")


def check_torch() -> Check:
    """Torch at the locked version, and no torchvision beside it."""
    if vision := read_version("torchvision"):
        detail = f"torchvision {vision} is installed; it has to be built for torch's very build"
        return Check("torch", False, detail, "pip uninstall -y torchvision")
    return check_locked("torch")


def check_importable(name: str, module: str) -> Check:
    """Import a required module in a process of its own."""
    status, _, errors = run_python(f"import {module}")
    if status != 0:
        return Check(name, False, f"import {module}: {last_line(errors)}", LOCK_INSTALL)
    return Check(name, True, read_version(module) or "importable")


def check_repository(root: Path | None = None) -> Check:
    """DVC, and the git repository that it keeps its books in."""
    root = root or (ROOT if (ROOT / "pyproject.toml").is_file() else Path.cwd())
    dvc = read_version("dvc")
    if dvc is None:
        return Check("dvc", False, "not installed", LOCK_INSTALL)
    if shutil.which("git") is None:
        return Check("dvc", False, "git is not on the PATH", "apt install git (or your system's)")
    if not (root / ".git").exists():
        return Check("dvc", False, f"{root} is no git repository", f"git init '{root}'")
    if not (root / ".dvc" / "config").is_file():
        return Check("dvc", False, f"{root}/.dvc is missing", "git checkout -- .dvc (or dvc init)")
    return Check("dvc", True, f"{dvc}, in {root}")


def check_lpips_weights() -> Check:
    """The weight file that metrics.weights would read, and that it is the known one."""
    try:
        weights = importlib.import_module("metrics.weights")
    except ImportError as error:
        return Check("LPIPS weights", None, str(error), "make venv")
    try:
        path = weights.find_vgg()
        weights.read_vgg(path)
    except ValueError as error:  # MetricUnavailable: its words name the command
        detail, _, remedy = str(error).partition(": ")
        return Check("LPIPS weights", None, f"{detail}; LPIPS will be null", remedy)
    return Check("LPIPS weights", True, str(path))


def check_flip() -> Check:
    """NVIDIA's FLIP evaluator, without which that metric is null."""
    if find_spec("flip_evaluator") is None:
        remedy = "pip install --no-deps flip-evaluator==1.7"
        return Check("FLIP", None, "flip-evaluator is not installed; FLIP will be null", remedy)
    return Check("FLIP", True, f"flip-evaluator {read_version('flip-evaluator')}")


def check_baselines() -> list[Check]:
    """What systems that the field is compared with need, each for itself."""
    try:
        available = importlib.import_module("gpf.baselines.available")
    except Exception as error:  # whatever ails mitsuba or drjit, other checks have its words
        return [Check("baselines", None, f"cannot be looked at: {error}", "mend mitsuba first")]
    return [
        Check(part.name, part.there or None, part.detail, part.remedy)
        for part in available.list_parts()
    ]


def check_disk() -> Check:
    """Room for what the pipeline writes into the working folder."""
    free = shutil.disk_usage(Path.cwd()).free / 2**30
    remedy = "dvc gc --workspace, or free some space"
    detail = f"{free:.1f} GiB free here, {FREE_DISK_GIB:.0f} needed"
    return Check("disk", free >= FREE_DISK_GIB, detail, remedy)


def check_memory() -> Check:
    """The machine's memory; little of it only narrows the choice of profile."""
    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    enough = True if total >= MEMORY_GIB else None
    detail = f"{total:.1f} GiB, {MEMORY_GIB:.0f} advised"
    return Check("memory", enough, detail, "take the profile smoke or desk")


def _shorten(path: Path) -> str:
    """The path as typed from the working folder, where it lies below it."""
    return str(path.relative_to(Path.cwd())) if path.is_relative_to(Path.cwd()) else str(path)

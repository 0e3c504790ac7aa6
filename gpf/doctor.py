"""`gpf doctor`: what works on this machine, what is missing, and the command that fixes it.

:func:`diagnose` runs the checks, :func:`print_report` prints them. Code that could kill a process
(a kernel compiled by an unknown libLLVM, an import of compiled code) runs in a subprocess. In a
checkout of the project, what the pipeline needs is checked as well: the versions in the lock
file, the repository, the weights of the metrics, the baselines.
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
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.text import Text

from gpf.core.checkout import CHECKOUT
from gpf.core.errors import UserError
from gpf.core.machine import count_cores, count_memory, read_cpu_model, read_version
from gpf.core.runtime import LLVM_INSTALL, LLVM_MINIMUM, LLVM_VARIABLE, VARIANT
from gpf.core.subprocesses import PROBE_SUM, last_line, run_probe, run_python

PYTHONS = ((3, 11), (3, 12), (3, 13))
LOCK = CHECKOUT / "requirements.lock" if CHECKOUT else None
LOCK_INSTALL = "pip install -r requirements.lock"

FREE_DISK_GIB = 2.0
"""More than the default profile writes, DVC's cache included."""
MEMORY_GIB = 4.0
"""With less, the larger profiles may run out of memory."""


@dataclass(frozen=True)
class Check:
    """One line of the report. ``ok`` is None where something optional is missing."""

    name: str
    ok: bool | None
    detail: str
    remedy: str = ""
    """The command that fixes it, or advice."""


def diagnose() -> list[Check]:
    """Run all checks that apply here; takes a few seconds and changes nothing."""
    probe = run_probe()
    library = [
        check_python(),
        *(check_package(package) for package in ("mitsuba", "drjit")),
        check_cuda(probe),
        check_libllvm(probe),
        check_importable("OpenEXR", "OpenEXR"),
        check_blender(),
        Check("processor", True, f"{read_cpu_model()}, {count_cores()} cores for this process"),
    ]
    return library if CHECKOUT is None else [*library, *diagnose_pipeline(CHECKOUT)]


def diagnose_pipeline(checkout: Path) -> list[Check]:
    """Check what the pipeline in a checkout of the project needs besides the library."""
    return [
        check_torch(),
        check_repository(checkout),
        check_lpips_weights(),
        check_flip(),
        *check_baselines(),
        check_disk(),
        check_memory(),
    ]


def print_report(checks: Sequence[Check], console: Console | None = None) -> int:
    """Print each check, and its remedy if it failed; return 0 if nothing required fails, else 1."""
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
        console.print(line, soft_wrap=True)  # not wrapped: commands are copied from here
    failed = [check.name for check in checks if check.ok is False]
    notes = [check.name for check in checks if check.ok is None]
    if failed:
        console.print(f"\nNeeds fixing: {', '.join(failed)}.", soft_wrap=True)
    else:
        optional = f" (optional: {', '.join(notes)})" if notes else ""
        console.print(f"\nEverything required works{optional}.", soft_wrap=True)
    return 1 if failed else 0


def spell_out(remedy: str) -> str:
    """Replace ``pip`` with that of this interpreter, and the lock file with its path.

    If the environment is not activated, plain ``pip`` is the system's.
    """
    interpreter = shlex.quote(_shorten(Path(sys.executable)))
    remedy = re.sub(r"(?<![/\w])pip (?=(un)?install)", lambda _: f"{interpreter} -m pip ", remedy)
    return remedy.replace("requirements.lock", shlex.quote(_shorten(LOCK))) if LOCK else remedy


def install_command(package: str) -> str:
    """The command that installs a suitable version of a package.

    In a checkout, that is the lock file's version, elsewhere one that the library's requirements
    allow.
    """
    if LOCK is not None:
        return LOCK_INSTALL
    try:
        requirements = metadata.requires("gaussian-photon-fields") or []
    except metadata.PackageNotFoundError:  # not installed, but imported from a folder
        requirements = []
    for requirement in requirements:
        if re.match(rf"{re.escape(package)}(?![\w.-])", requirement, re.IGNORECASE):
            return f"pip install {shlex.quote(requirement)}"
    return f"pip install {package}"


def check_python() -> Check:
    """Python has a version that the lock file was tested with."""
    ok = sys.version_info[:2] in PYTHONS
    remedy = "rm -rf .venv && make venv PYTHON=python3.11"
    if CHECKOUT is None:
        remedy = "install into an environment with Python 3.11, 3.12 or 3.13"
    return Check("Python", ok, f"{platform.python_version()} at {sys.executable}", remedy)


def check_package(package: str) -> Check:
    """A package is installed, in the version of the lock file if there is one."""
    found, locked = read_version(package), read_lock().get(package.lower())
    if found is None:
        return Check(package, False, "not installed", install_command(package))
    # A build suffix (torch 2.13.0+cpu) does not make it another version.
    if locked is not None and found.partition("+")[0] != locked:
        return Check(package, False, f"{found}, but the lock file says {locked}", LOCK_INSTALL)
    return Check(package, True, found if locked else f"{found} (no lock file to compare with)")


def read_lock(path: Path | None = None) -> dict[str, str]:
    """Read the lock file as {package in lower case: version}; empty if there is none."""
    path = path or LOCK
    if path is None or not path.is_file():
        return {}
    pairs = re.findall(r"^([\w.-]+)==([^\s;]+)", path.read_text(encoding="utf-8"), re.MULTILINE)
    return {name.lower(): version for name, version in pairs}


def check_libllvm(probe: dict[str, Any]) -> Check:
    """A libLLVM that is new enough and compiled a kernel; required unless CUDA works."""
    version, path = probe.get("llvm"), os.environ.get(LLVM_VARIABLE)
    remedy = f"unset {LLVM_VARIABLE}; {LLVM_INSTALL}"
    if version is None:
        detail = f"the subprocess died before it could check: {probe.get('died')}"
        remedy = install_command("drjit")
    elif version[0] < 0:
        detail = f"none that Dr.Jit can use ({LLVM_VARIABLE}={path or ''})"
    else:
        detail = f"{'.'.join(map(str, version))}, {path or 'found on the system'}"
        if version[0] < LLVM_MINIMUM:
            detail += f": older than {LLVM_MINIMUM}, so it would crash the renderer"
        elif probe.get("llvm_sum") != PROBE_SUM:
            detail += f": a small kernel failed ({probe.get('died', 'wrong result')})"
        else:
            return Check("libLLVM", True, detail)
    return Check("libLLVM", None if _has_cuda(probe) else False, detail, remedy)


def _has_cuda(probe: dict[str, Any]) -> bool:
    return probe.get("cuda_sum") == PROBE_SUM


def check_cuda(probe: dict[str, Any]) -> Check:
    """A CUDA device that ran a kernel; without one, kernels run on the CPU."""
    if _has_cuda(probe):
        return Check("CUDA", True, "a device that runs kernels, and is used")
    if "cuda" not in probe:
        return Check(
            "CUDA", None, "the subprocess died before it could check", install_command("drjit")
        )
    if not probe["cuda"]:
        remedy = "nothing to do; if you have an NVIDIA GPU, install its driver"
        return Check("CUDA", None, "no device: kernels run on the CPU", remedy)
    detail = f"a device, but a small kernel failed on it ({probe.get('died', 'wrong result')})"
    return Check("CUDA", False, detail, f"export {VARIANT}=llvm_ad_rgb")


def check_torch() -> Check:
    """Torch is installed at the locked version, and without torchvision."""
    if vision := read_version("torchvision"):
        detail = f"torchvision {vision} is installed, which needs its own build of torch"
        return Check("torch", False, detail, "pip uninstall -y torchvision")
    return check_package("torch")


def check_importable(name: str, module: str) -> Check:
    """A required module can be imported, in a subprocess."""
    status, _, errors = run_python(f"import {module}")
    if status != 0:
        return Check(name, False, f"import {module}: {last_line(errors)}", install_command(name))
    return Check(name, True, read_version(module) or "importable")


def check_repository(root: Path) -> Check:
    """DVC is installed, and the project is a git repository with a DVC configuration."""
    dvc = read_version("dvc")
    if dvc is None:
        return Check("dvc", False, "not installed", LOCK_INSTALL)
    if shutil.which("git") is None:
        return Check("dvc", False, "git is not on the PATH", "apt install git (or your system's)")
    if not (root / ".git").exists():
        return Check("dvc", False, f"{root} is not a git repository", f"git init '{root}'")
    if not (root / ".dvc" / "config").is_file():
        return Check("dvc", False, f"{root}/.dvc is missing", "git checkout -- .dvc (or dvc init)")
    return Check("dvc", True, f"{dvc}, in {root}")


def check_lpips_weights() -> Check:
    """The weights of LPIPS are installed, and are the file that :mod:`metrics.weights` expects."""
    try:
        weights = importlib.import_module("metrics.weights")
    except ImportError as error:
        return Check("LPIPS weights", None, str(error), "make venv")
    try:
        path = weights.find_vgg()
        weights.read_vgg(path)
    except ValueError as error:  # MetricUnavailable: "what is missing: command"
        detail, _, remedy = str(error).partition(": ")
        return Check("LPIPS weights", None, f"{detail}; LPIPS will be null", remedy)
    return Check("LPIPS weights", True, str(path))


def check_flip() -> Check:
    """NVIDIA's FLIP evaluator is installed; without it, the metric is null."""
    if find_spec("flip_evaluator") is None:
        remedy = "pip install --no-deps flip-evaluator==1.7"
        return Check("FLIP", None, "flip-evaluator is not installed; FLIP will be null", remedy)
    return Check("FLIP", True, f"flip-evaluator {read_version('flip-evaluator')}")


def check_baselines() -> list[Check]:
    """The optional parts of the baselines are installed."""
    try:
        available = importlib.import_module("baselines.available")
    except Exception as error:  # from mitsuba or drjit; other checks report it
        return [Check("baselines", None, f"cannot be checked: {error}", "fix mitsuba first")]
    return [
        Check(part.name, part.there or None, part.detail, part.remedy)
        for part in available.list_parts()
    ]


def check_blender() -> Check:
    """Blender is there, to read files of other programs."""
    try:
        from gpf.blender.process import find_blender, version_of

        command = find_blender()
    except UserError as error:
        return Check("Blender", None, f"{error.where} {error.what}", "gpf blender-install")
    except ImportError as error:
        return Check("Blender", None, f"cannot be checked: {error}", "pip install platformdirs")
    version = ".".join(map(str, version_of(command)))
    return Check("Blender", True, f"{version}: {command[0]}")


def check_disk() -> Check:
    """The working folder has space for the pipeline's output."""
    free = shutil.disk_usage(Path.cwd()).free / 2**30
    remedy = "dvc gc --workspace, or free some space"
    detail = f"{free:.1f} GiB free here, {FREE_DISK_GIB:.0f} needed"
    return Check("disk", free >= FREE_DISK_GIB, detail, remedy)


def check_memory() -> Check:
    """How much memory there is; with little, use a small profile."""
    total = count_memory() / 2**30
    enough = True if total >= MEMORY_GIB else None
    detail = f"{total:.1f} GiB, {MEMORY_GIB:.0f} recommended"
    return Check("memory", enough, detail, "use the profile quick or desk")


def _shorten(path: Path) -> str:
    """The path relative to the working folder, if it lies below it."""
    return str(path.relative_to(Path.cwd())) if path.is_relative_to(Path.cwd()) else str(path)

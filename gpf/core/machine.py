"""The machine and the software on it: cores, memory, versions.

Like :mod:`gpf.core.runtime`, this module does not import drjit or mitsuba at the top level.
"""

import os
import platform
import re
import resource
import subprocess
from contextlib import suppress
from importlib import metadata
from pathlib import Path
from typing import Any

from gpf.core.errors import UserError

DESCRIBED_PACKAGES = ("mitsuba", "drjit", "numpy", "scipy", "torch")

CONTAINER_LIMIT = Path("/sys/fs/cgroup/memory.max")


def device_description() -> dict[str, Any]:
    """Describe the machine and the software, for cost records.

    JSON values: ``cpu`` (model), ``cores`` (that this process may use), ``gpu`` (name or None),
    ``variant`` (the active one or None), ``llvm`` (version or None), ``python`` (version),
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
    """The name of the processor, or its architecture if the system does not give the name."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        text = ""
    match = re.search(r"^model name\s*:\s*(.+)$", text, re.MULTILINE)
    return match.group(1).strip() if match else platform.processor() or platform.machine()


def count_cores() -> int:
    """The number of logical cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):  # not on macOS
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def count_memory() -> int:
    """The memory that this process may use, bytes, excluding GPU memory."""
    limits = [os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")]
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit != resource.RLIM_INFINITY:
        limits.append(limit)
    with suppress(OSError, ValueError):  # no container, or one without a limit ("max")
        limits.append(int(CONTAINER_LIMIT.read_text()))
    return min(limits)


def require_memory(where: str, value: object, needed: float) -> None:
    """Raise a :class:`UserError` if a value needs more memory than there is.

    Parameters
    ----------
    where, value: the setting that needs it.
    needed: bytes; a lower bound, so that nothing that would work is refused.
    """
    if needed > (there := count_memory()):
        raise UserError(
            where,
            f"is {value}, which needs at least {needed / 2**30:,.1f} GiB of memory; "
            f"{there / 2**30:,.1f} GiB are available",
            "Choose a smaller value.",
        )


def read_version(package: str) -> str | None:
    """The version of an installed package, without importing it; None if it is not installed."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def read_commit() -> str | None:
    """The commit of the checkout that contains this file; None for an installed copy.

    An installed copy may lie inside the repository of another project (``.venv/``).
    """
    root = Path(__file__).resolve().parents[2]
    answer = _run("git", "-C", str(root), "rev-parse", "--show-toplevel", "HEAD").splitlines()
    if len(answer) != 2 or Path(answer[0]).resolve() != root:
        return None
    return answer[1]


def _run(*command: str) -> str:
    """The output of a command; empty if the command does not exist or fails."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=10, check=True)
    except (OSError, subprocess.SubprocessError):
        return ""
    return done.stdout.strip()

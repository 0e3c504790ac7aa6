"""The costs of a stage: wall-clock and CPU seconds, with kernel compilation counted separately."""

from __future__ import annotations

import resource
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import drjit as dr

from gpf.core.errors import FileError
from gpf.core.files import read_json, write_json
from gpf.core.machine import device_description
from metrics.files import CostFile

KINDS = ("wall_seconds", "cpu_seconds", "compile_seconds")


class CostMeter:
    """Measures named parts of a stage.

    A part's ``wall_seconds`` and ``cpu_seconds`` exclude the time in which Dr.Jit compiled kernels,
    which is ``compile_seconds``. Dr.Jit caches compiled kernels on disk, so this is near zero from
    the second run on.
    """

    def __init__(self, parts: Mapping[str, Mapping[str, float]] | None = None) -> None:
        self.parts: dict[str, dict[str, float]] = {k: dict(v) for k, v in (parts or {}).items()}
        self.facts: dict[str, Any] = {}

    @classmethod
    def load(cls, path: Path) -> CostMeter:
        """Start from the costs of an earlier run, for stages that redo only what changed."""
        found = read_json(path, CostFile) if path.exists() else {"parts": {}, "facts": {}}
        meter = cls(found["parts"])
        meter.facts |= found["facts"]
        return meter

    @contextmanager
    def measure(self, part: str) -> Iterator[None]:
        """Add the time of the block, including work on the device, to ``part``."""
        dr.sync_thread()
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            self._started = time.perf_counter(), time.process_time()
            try:
                yield
            finally:
                self.parts[part] = self.so_far(part)
                del self._started

    def so_far(self, part: str) -> dict[str, float]:
        """The cost so far of ``part``, which is being measured."""
        dr.sync_thread()
        now = time.perf_counter(), time.process_time()
        compiled = _compile_seconds()
        entry = dict(self.parts.get(part, dict.fromkeys(KINDS, 0.0)))
        # Threads compile side by side, so their time may be longer than that of the clock.
        entry["wall_seconds"] += max(now[0] - self._started[0] - compiled, 0)
        entry["cpu_seconds"] += now[1] - self._started[1] - compiled
        entry["compile_seconds"] += compiled
        self._started = now
        self.parts[part] = entry
        return entry

    def share(self, part: str, names: Sequence[str]) -> None:
        """Split a part into equal shares, ``part/name`` for each name."""
        whole = self.parts.pop(part)
        for name in names:
            self.parts[f"{part}/{name}"] = {k: v / len(names) for k, v in whole.items()}

    def note_peak_memory(self) -> None:
        """Record the peak memory of this process plus that of its child processes, in MB."""
        self.facts["peak_memory_megabytes"] = sum(
            peak_memory(who) / 1e6 for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
        )

    def write(self, path: Path) -> None:
        """Write the parts, the facts and a description of the machine."""
        machine = device_description()
        write_json(path, {"parts": self.parts, "facts": self.facts, "machine": machine})


def peak_memory(who: int = resource.RUSAGE_SELF) -> int:
    """The peak memory, bytes, of this process or of its child processes."""
    unit = 1 if sys.platform == "darwin" else 1024  # macOS counts bytes, Linux kibibytes
    return unit * resource.getrusage(who).ru_maxrss


@contextmanager
def times_of(path: Path) -> Iterator[None]:
    """Report a time that is missing from a cost file together with the file."""
    try:
        yield
    except KeyError as error:
        raise FileError(path, f"has no time for {error.args[0]!r}") from error


def _compile_seconds() -> float:
    """Seconds of code generation and compilation in the kernel history; empties the history."""
    entries = dr.kernel_history([dr.KernelType.JIT])
    misses = (e for e in entries if not e.get("cache_hit", True))
    return sum(e.get("backend_time", 0.0) + e.get("codegen_time", 0.0) for e in misses) / 1e3

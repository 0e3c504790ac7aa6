"""What a stage cost: wall and CPU seconds, with the compilation of kernels apart."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import drjit as dr

from gpf.artifacts import write_json
from gpf.runtime import device_description


class CostMeter:
    """Measures named parts of a stage.

    A part's ``wall_seconds`` and ``cpu_seconds`` do not include the time that Dr.Jit spent on
    compiling kernels; ``compile_seconds`` has it. Dr.Jit keeps compiled kernels on disk, so that
    it is near zero from the second run on.
    """

    def __init__(self) -> None:
        self.parts: dict[str, dict[str, float]] = {}
        self.facts: dict[str, Any] = {}

    @contextmanager
    def measure(self, part: str) -> Iterator[None]:
        """Add the time until the block ends, device work included, to ``part``."""
        dr.sync_thread()
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            wall, cpu = time.perf_counter(), time.process_time()
            try:
                yield
            finally:
                dr.sync_thread()
                wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
                compiled = _compile_seconds()
        entry = self.parts.setdefault(
            part, {"wall_seconds": 0.0, "cpu_seconds": 0.0, "compile_seconds": 0.0}
        )
        entry["wall_seconds"] += max(wall - compiled, 0.0)
        entry["cpu_seconds"] += max(cpu - compiled, 0.0)
        entry["compile_seconds"] += compiled

    def write(self, path: Path) -> None:
        """Write the parts, further facts and a description of the machine."""
        machine = device_description()
        write_json(path, {"parts": self.parts, "facts": self.facts, "machine": machine})


def _compile_seconds() -> float:
    """Seconds of code generation and compilation in the kernel history, which is emptied."""
    entries = dr.kernel_history([dr.KernelType.JIT])
    misses = (e for e in entries if not e.get("cache_hit", True))
    return sum(e.get("backend_time", 0.0) + e.get("codegen_time", 0.0) for e in misses) / 1e3

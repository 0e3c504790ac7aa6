"""When a fit ends, and how long it takes."""

from __future__ import annotations

import statistics
import time
from collections import deque
from dataclasses import dataclass
from types import TracebackType

import drjit as dr

from gpf.core.errors import UserError

DEFAULT_PASSES = 300
"""Photon passes if no time, PSNR or number of passes is asked for."""


LATELY = 9
"""The time of the next passes is predicted from this many recent ones."""


@dataclass(frozen=True)
class Goals:
    """A fit stops when the first of these is reached.

    Attributes
    ----------
    seconds: wall-clock time for the whole fit, or None for no limit.
    target_psnr: estimated PSNR of images, dB, or None for no target.
    passes: photon passes; infinity for no limit.
    """

    seconds: float | None
    target_psnr: float | None
    passes: float

    @staticmethod
    def asked(seconds: float | None, target_psnr: float | None, passes: int | None) -> Goals:
        """The goals that a user asks for; without any, :data:`DEFAULT_PASSES` passes.

        Raises
        ------
        UserError: a goal is not above 0.
        """
        asked = {"seconds": seconds, "target_psnr": target_psnr, "passes": passes}
        for name, value in asked.items():
            if value is not None and not value > 0:  # or NaN
                raise UserError(name, f"is {value}", "Give a number above 0, or leave it out.")
        if all(value is None for value in asked.values()):
            passes = DEFAULT_PASSES
        # Two halves of the photons are compared, so at least two passes are needed.
        return Goals(seconds, target_psnr, float("inf") if passes is None else max(passes, 2))


def require_seed(seed: int) -> None:
    """Raise a :class:`UserError` unless this can be a seed."""
    if not 0 <= seed < 2**31:
        raise UserError("seed", f"is {seed}", "Give a number from 0 to 2147483647.")


class TimeBudget:
    """The wall-clock time of a fit, and the part of it that is work.

    Work is the time within a ``with`` block, except while Dr.Jit compiles kernels. They are
    compiled once, so that time says nothing about what comes next.

    Attributes
    ----------
    pass_seconds: mean time of recent passes, some of which include samples.
    """

    def __init__(self, seconds: float | None) -> None:
        self.begin = self._last = time.perf_counter()
        self._end = float("inf") if seconds is None else self.begin + seconds
        self._passes: deque[float] = deque(maxlen=LATELY)
        self._is_first_pass = True
        self.pass_seconds = 0.0
        self._work_begin, self._compiling = self.begin, 0.0

    def __enter__(self) -> TimeBudget:
        self._work_begin, self._compiling = time.perf_counter(), 0.0
        self._had_history = dr.flag(dr.JitFlag.KernelHistory)
        dr.set_flag(dr.JitFlag.KernelHistory, True)
        dr.kernel_history_clear()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        where: TracebackType | None,
    ) -> None:
        dr.set_flag(dr.JitFlag.KernelHistory, self._had_history)

    @property
    def work(self) -> float:
        """Seconds of work so far."""
        self._compiling += _seconds_of_compiling()
        return time.perf_counter() - self._work_begin - self._compiling

    @property
    def left(self) -> float:
        """Seconds until the end; infinite without one."""
        return self._end - time.perf_counter()

    @property
    def spent(self) -> float:
        """Seconds since the start."""
        return time.perf_counter() - self.begin

    def is_over(self, reserve: float = 0) -> bool:
        """Whether less than ``reserve`` seconds are left."""
        return time.perf_counter() + reserve > self._end

    def note_pass(self) -> None:
        """Note that a pass has ended. The time of the first is ignored, because it compiled
        kernels; others take longer if they make room for photons."""
        if not self._is_first_pass:
            self._passes.append(time.perf_counter() - self._last)
            self.pass_seconds = statistics.mean(self._passes)
        self._is_first_pass = False

    def lengthen_passes(self, seconds: float) -> None:
        """Expect each pass to take ``seconds`` longer from now on."""
        self._passes.clear()
        self.pass_seconds += seconds

    def start_pass(self) -> None:
        """Note that the next pass begins now."""
        self._last = time.perf_counter()


def _seconds_of_compiling() -> float:
    """Compile time since the last call, if Dr.Jit keeps the history of its kernels."""
    kernels = dr.kernel_history([dr.KernelType.JIT])
    return sum(float(kernel["backend_time"]) for kernel in kernels) / 1000

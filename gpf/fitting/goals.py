"""When a fit ends, and the time that it takes."""

from __future__ import annotations

import statistics
import time
from collections import deque
from dataclasses import dataclass
from types import TracebackType

import drjit as dr

from gpf.core.errors import UserError

DEFAULT_PASSES = 300
"""Photon passes if neither a time, a PSNR nor a number of passes is asked for."""


LATELY = 9
"""Passes whose time tells that of the next ones."""


@dataclass(frozen=True)
class Goals:
    """A fit ends at the first of these that is reached.

    Attributes
    ----------
    seconds: time for the whole fit, wall clock; None without a limit.
    target_psnr: estimated PSNR of images, dB; None for any.
    passes: photon passes; infinity for any number.
    """

    seconds: float | None
    target_psnr: float | None
    passes: float

    @staticmethod
    def of(seconds: float | None, target_psnr: float | None, passes: int | None) -> Goals:
        """The goals that are asked for; without any, :data:`DEFAULT_PASSES` passes.

        Raises
        ------
        UserError: one is not above 0.
        """
        asked = {"seconds": seconds, "target_psnr": target_psnr, "passes": passes}
        for name, value in asked.items():
            if value is not None and not value > 0:  # or NaN
                raise UserError(name, f"is {value}", "Give a number above 0, or leave it out.")
        if all(value is None for value in asked.values()):
            passes = DEFAULT_PASSES
        # Two halves of the photons are compared, so there are two passes at least.
        return Goals(seconds, target_psnr, float("inf") if passes is None else max(passes, 2))


class TimeBudget:
    """The time of a fit, wall clock.

    Attributes
    ----------
    pass_seconds: of a pass, lately (mean: samples come with some passes).
    """

    def __init__(self, seconds: float | None) -> None:
        self.begin = self._last = time.perf_counter()
        self._end = float("inf") if seconds is None else self.begin + seconds
        self._passes: deque[float] = deque(maxlen=LATELY)
        self._compiling = True
        self.pass_seconds = 0.0

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
        """A pass has ended. The time of the first is ignored, because it compiled kernels; others
        take longer if they make room for photons."""
        if not self._compiling:
            self._passes.append(time.perf_counter() - self._last)
            self.pass_seconds = statistics.mean(self._passes)
        self._compiling = False

    def lengthen_passes(self, seconds: float) -> None:
        """From now on, passes take longer by so much."""
        self._passes.clear()
        self.pass_seconds += seconds

    def start_pass(self) -> None:
        """The next pass begins now."""
        self._last = time.perf_counter()


class WorkClock:
    """A clock that runs within a ``with`` block, and stands still while Dr.Jit compiles kernels.
    They are compiled once, so that time says nothing of what comes next."""

    def __enter__(self) -> WorkClock:
        self._begin, self._compiling = time.perf_counter(), 0.0
        self._recorded = dr.flag(dr.JitFlag.KernelHistory)
        dr.set_flag(dr.JitFlag.KernelHistory, True)
        dr.kernel_history_clear()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        where: TracebackType | None,
    ) -> None:
        dr.set_flag(dr.JitFlag.KernelHistory, self._recorded)

    def seconds(self) -> float:
        """Since the block began."""
        self._compiling += _seconds_of_compiling()
        return time.perf_counter() - self._begin - self._compiling


def _seconds_of_compiling() -> float:
    """Since the last call, if Dr.Jit keeps the history of its kernels."""
    kernels = dr.kernel_history([dr.KernelType.JIT])
    return sum(float(kernel["backend_time"]) for kernel in kernels) / 1000

"""The time of a fit: what is over, and how many passes still fit into it."""

from __future__ import annotations

import time

# Of the time that is left, this share is planned with.
_PLANNED = 0.9


class TimeBudget:
    """The time of a fit, wall clock.

    Attributes
    ----------
    pass_seconds: of a pass, lately.
    field_seconds: that the next field will take, from its targets to its judgement.
    judging: of that, seconds of its judgement.
    """

    def __init__(self, seconds: float | None) -> None:
        self.begin = self._last = time.perf_counter()
        self._end = float("inf") if seconds is None else self.begin + seconds
        self.pass_seconds, self.field_seconds, self.judging = 0.0, 0.0, 0.0

    @property
    def spent(self) -> float:
        """Seconds since the start."""
        return time.perf_counter() - self.begin

    def is_over(self, reserve: float = 0) -> bool:
        """Whether less than ``reserve`` seconds are left."""
        return time.perf_counter() + reserve > self._end

    def note_pass(self, count: bool) -> None:
        """A pass has ended. If it does not count, because it compiled kernels, its time is
        ignored."""
        spent = time.perf_counter() - self._last
        if count:
            self.pass_seconds = 0.8 * (self.pass_seconds or spent) + 0.2 * spent

    def start_pass(self) -> None:
        """The next pass begins now."""
        self._last = time.perf_counter()

    def passes_left(self, share: float, fields: int = 1) -> float:
        """Passes for which there is time before so many fields.

        Parameters
        ----------
        share: passes for the estimate of the PSNR, of those for the field.
        """
        rest = self._end - time.perf_counter() - fields * self.field_seconds
        return _PLANNED * rest / max(self.pass_seconds * (1 + share), 1e-6)

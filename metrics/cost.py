"""What a method costs over many views: preparation once, then so much per view."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas


# Names of the lines that the stage `amortize` writes.
GPF = "GPF"
SPPM = "SPPM"
SPPM_AT_EQUAL_QUALITY = "SPPM at equal quality"
SPPM_TOGETHER = "SPPM, views together"


@dataclass(frozen=True)
class CostLine:
    """The cost of a method in seconds as a straight line over the number of views."""

    name: str
    preparation_seconds: float
    per_view_seconds: float

    def __post_init__(self) -> None:
        """Refuse times that cannot be."""
        for field in ("preparation_seconds", "per_view_seconds"):
            seconds = getattr(self, field)
            if not (math.isfinite(seconds) and seconds >= 0):
                raise ValueError(
                    f"{field} of {self.name} is {seconds}; give a finite time of 0 s or more"
                )

    def total(self, views: int) -> float:
        """Seconds for ``views`` views, the preparation counted once."""
        return self.preparation_seconds + views * self.per_view_seconds


def break_even(a: CostLine, b: CostLine) -> int | None:
    """Find the smallest number of views from which on ``a`` is cheaper than ``b``.

    That is the smallest n >= 1 with ``a.total(m) < b.total(m)`` for all m >= n.
    ``None`` if there is none; so also where ``a`` is cheaper at first and loses
    that lead, because it costs more per view.
    """
    # Exact: in floats, a quotient may round to the other side of a whole number.
    saved = Fraction(b.per_view_seconds) - Fraction(a.per_view_seconds)
    extra = Fraction(a.preparation_seconds) - Fraction(b.preparation_seconds)
    if saved < 0 or (saved == 0 and extra >= 0):
        return None
    return 1 if extra < 0 else math.floor(extra / saved) + 1


def cumulative(
    lines: Sequence[CostLine], views: Iterable[int] = range(1, 101)
) -> "pandas.DataFrame":
    """Seconds over numbers of views: a column ``views`` and one per line, by its name."""
    import pandas

    names = [line.name for line in lines]
    if len(set(names)) < len(names) or "views" in names:
        raise ValueError(f"the lines are named {names}; each needs a name of its own, not 'views'")
    counts = list(views)
    if any(count < 0 for count in counts):
        raise ValueError(f"the numbers of views go down to {min(counts)}; give 0 or more")
    columns = {line.name: [line.total(n) for n in counts] for line in lines}
    return pandas.DataFrame({"views": counts} | columns)

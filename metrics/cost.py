"""The cost of a method over many views: a preparation, and a time per view."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction

import pandas as pd

# Names of the lines that the stage `amortize` writes.
GPF = "GPF"
SPPM = "SPPM"
SPPM_AT_EQUAL_QUALITY = "SPPM at equal quality"
SPPM_TOGETHER = "SPPM, views together"


@dataclass(frozen=True)
class CostLine:
    """The cost of a method in seconds, a straight line over the number of views.

    Raises
    ------
    ValueError: a time is negative or not finite.
    """

    name: str
    preparation_seconds: float
    per_view_seconds: float

    def __post_init__(self) -> None:
        """Check the times."""
        for field in ("preparation_seconds", "per_view_seconds"):
            seconds = getattr(self, field)
            if not (math.isfinite(seconds) and seconds >= 0):
                raise ValueError(
                    f"{field} of {self.name} is {seconds}; give a finite time of 0 s or more"
                )

    def total(self, views: int) -> float:
        """``preparation_seconds + views * per_view_seconds``."""
        return self.preparation_seconds + views * self.per_view_seconds


def break_even(a: CostLine, b: CostLine) -> int | None:
    """The smallest n >= 1 with ``a.total(m) < b.total(m)`` for all m >= n.

    ``None`` if there is no such n. One such case: ``a`` is cheaper for few views, but costs more
    per view.
    """
    # Fractions are exact. With floats, the quotient could round past a whole number.
    saved = Fraction(b.per_view_seconds) - Fraction(a.per_view_seconds)
    extra = Fraction(a.preparation_seconds) - Fraction(b.preparation_seconds)
    if saved < 0 or (saved == 0 and extra >= 0):
        return None
    return 1 if extra < 0 else math.floor(extra / saved) + 1


def cumulative(lines: Sequence[CostLine], views: Iterable[int] = range(1, 101)) -> pd.DataFrame:
    """Total seconds for each number of views: a column ``views`` and one column per line.

    Raises
    ------
    ValueError: two lines have the same name, a line is named `views`, or a number is negative.
    """
    names = [line.name for line in lines]
    if len(set(names)) < len(names) or "views" in names:
        raise ValueError(f"the lines are named {names}; use different names, and not 'views'")
    counts = list(views)
    if any(count < 0 for count in counts):
        raise ValueError(f"the smallest number of views is {min(counts)}; give 0 or more")
    columns = {line.name: [line.total(n) for n in counts] for line in lines}
    return pd.DataFrame({"views": counts} | columns)

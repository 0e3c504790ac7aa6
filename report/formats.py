"""Numbers as people read them: as many digits as they are worth."""

from __future__ import annotations

import math
from collections.abc import Callable

Form = Callable[[float], str]


def fixed(digits: int) -> Form:
    """So many digits behind the point."""
    return lambda value: f"{value:.{digits}f}"


def significant(digits: int) -> Form:
    """So many digits that count, and no exponent: 49.5, 0.145, 1,203."""

    def write(value: float) -> str:
        if value == 0 or not math.isfinite(value):
            return f"{value:.0f}"
        # Rounding may carry into a further place: 9.996 is 10.0.
        value = float(f"{value:.{digits - 1}e}") if abs(value) < 10**digits else value
        behind = digits - 1 - math.floor(math.log10(abs(value)))
        return f"{value:,.{max(behind, 0)}f}"

    return write


def signed(digits: int) -> Form:
    """A difference, with its sign."""
    return lambda value: f"{value:+.{digits}f}".replace("-", "−")


def whole(value: float) -> str:
    """A count."""
    return f"{value:,.0f}"


def join(words: list[str]) -> str:
    """Words as a sentence lists them: a, b and c."""
    return " and ".join([*([", ".join(words[:-1])] if words[:-1] else []), *words[-1:]])

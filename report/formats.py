"""Numbers as text, with the digits that matter."""

from __future__ import annotations

import math
from collections.abc import Callable

Form = Callable[[float], str]


def fixed(digits: int) -> Form:
    """A fixed number of digits after the decimal point."""
    return lambda value: f"{value:.{digits}f}"


def significant(digits: int) -> Form:
    """A fixed number of significant digits, without an exponent: 49.5, 0.145, 1,203."""

    def write(value: float) -> str:
        if value == 0 or not math.isfinite(value):
            return f"{value:.0f}"
        # Round first: rounding can add a digit before the point (9.996 becomes 10.0).
        value = float(f"{value:.{digits - 1}e}") if abs(value) < 10**digits else value
        behind = digits - 1 - math.floor(math.log10(abs(value)))
        return f"{value:,.{max(behind, 0)}f}"

    return write


def signed(digits: int) -> Form:
    """A difference with its sign, + or −."""
    return lambda value: f"{value:+.{digits}f}".replace("-", "−")


def whole(value: float) -> str:
    """A whole number: 1,203."""
    return f"{value:,.0f}"


def join(words: list[str]) -> str:
    """A list in a sentence: `a, b and c`."""
    return " and ".join([*([", ".join(words[:-1])] if words[:-1] else []), *words[-1:]])

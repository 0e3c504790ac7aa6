"""LuxCore's scene files: one ``key = values`` a line."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

Properties = dict[str, Any]


def colour(value: Any) -> list[float]:
    """A number or a colour as three numbers."""
    return [float(c) for c in np.broadcast_to(value, 3)]


def matrix(value: Any) -> list[float]:
    """A matrix (4, 4), column by column."""
    return [float(x) for x in np.array(value, dtype=float).T.ravel()]


def to_text(properties: Properties) -> str:
    """The text of a file."""
    return "".join(f"{key} = {_words(value)}\n" for key, value in properties.items())


def _words(value: Any) -> str:
    if isinstance(value, bool):
        return str(int(value))
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, Sequence):
        return " ".join(map(_words, value))
    return f"{value:.9g}" if isinstance(value, float) else str(value)

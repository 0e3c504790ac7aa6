"""How many Gaussians a field may have."""

from __future__ import annotations

from typing import Literal

MOST_GAUSSIANS = 100_000
"""Of `field.gaussians: auto`: the paper's number."""


def most_gaussians(asked: int | Literal["auto"]) -> int:
    """As many as are asked for; with ``auto``, the number of which trials take their shares."""
    return MOST_GAUSSIANS if asked == "auto" else asked

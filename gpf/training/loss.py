"""How much the error at a point counts in the loss.

Errors count relative to the light at the point, so that dark points are learned as well. The light
is the field's own answer E there, not the target: targets are noisy, and points whose targets
happen to be dark would count more, which would make the field too dark. With

    ω = 1 / (b² + ⟨b⟩²),

b the mean of the channels of E and ⟨b⟩ the mean target, the field keeps the energy of its targets.
The gradient treats the weights as constants.
"""

from __future__ import annotations

from typing import Literal, TypeVar

Loss = Literal["squared", "relative"]
"""``squared``: all points count the same; ``relative``: as above."""

Level = TypeVar("Level")


def relative_weight(level: Level) -> Level:
    """ω, (N,), for b in units of the mean target, (N,); arrays of numpy or of Dr.Jit."""
    return 1 / (level * level + 1)  # type: ignore[operator]

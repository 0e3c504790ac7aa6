"""What the cost files of stages say: ``parts``, their seconds, and ``facts``.

All seconds are wall seconds without compilation.
"""

from collections.abc import Mapping
from typing import Any

Cost = Mapping[str, Any]


def part_seconds(cost: Cost, *names: str) -> float:
    """Seconds of some parts; those that were not run take none."""
    return float(
        sum(cost["parts"][name]["wall_seconds"] for name in names if name in cost["parts"])
    )


def seconds_per_view(render: Cost) -> float:
    """What a view takes; ``render``: of the stage `render`, or of a baseline.

    Raises
    ------
    KeyError: it was not timed; a view that takes no time would be a lie.
    """
    return float(render["parts"]["render"]["wall_seconds"]) / int(render["facts"]["views"])


def learning_seconds(train: Cost) -> float:
    """What the field takes to learn, the search for its number of Gaussians not counted."""
    return part_seconds(train, "stream", "training")


def target_seconds(reference: Cost, passes: int) -> float:
    """What the targets alone take: no images of views.

    Raises
    ------
    KeyError: they were not timed.
    """
    parts = reference["parts"]
    found = sum(parts[name]["wall_seconds"] for name in ("radius", "points"))
    return float(found + passes * reference["facts"]["seconds_per_target_pass"])


def passes_done(reference: Cost, group: str, asked: int) -> int:
    """How many passes a group has: fewer than asked for where its noise was low enough."""
    return int(reference.get("facts", {}).get("passes_done", {}).get(group, asked))

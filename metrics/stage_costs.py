"""Times from the cost files of stages, which have ``parts`` (seconds of each) and ``facts``.

All seconds are wall-clock time without the compilation of kernels.
"""

from collections.abc import Mapping
from typing import Any

Cost = Mapping[str, Any]


def part_seconds(cost: Cost, *names: str) -> float:
    """Total seconds of these parts; a part that was not run counts as 0."""
    return float(
        sum(cost["parts"][name]["wall_seconds"] for name in names if name in cost["parts"])
    )


def seconds_per_view(render: Cost) -> float:
    """Seconds per view, from the cost file of the stage `render` or of a baseline.

    Raises
    ------
    KeyError: rendering was not timed. (0 s would be wrong.)
    """
    return float(render["parts"]["render"]["wall_seconds"]) / int(render["facts"]["views"])


def learning_seconds(train: Cost) -> float:
    """Training time of the field, without the search for the number of Gaussians."""
    return part_seconds(train, "stream", "training")


def target_seconds(reference: Cost, passes: int) -> float:
    """Seconds to compute the training targets alone, without images of views.

    Raises
    ------
    KeyError: the targets were not timed.
    """
    parts = reference["parts"]
    found = sum(parts[name]["wall_seconds"] for name in ("radius", "points"))
    return float(found + passes * reference["facts"]["seconds_per_target_pass"])


def passes_done(reference: Cost, group: str, asked: int) -> int:
    """Passes that a group of images has; fewer than ``asked`` if its noise was low enough."""
    return int(reference.get("facts", {}).get("passes_done", {}).get(group, asked))

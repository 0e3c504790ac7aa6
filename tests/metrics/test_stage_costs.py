"""Times from the cost files of stages."""

import pytest

from metrics.stage_costs import (
    learning_seconds,
    part_seconds,
    passes_done,
    seconds_per_view,
    target_seconds,
)


def cost(facts: dict[str, object] | None = None, **seconds: float) -> dict[str, object]:
    parts = {
        name: {"wall_seconds": s, "cpu_seconds": 2 * s, "compile_seconds": 9.0}
        for name, s in seconds.items()
    }
    return {"parts": parts, "facts": facts or {}}


def test_parts_are_added_and_missing_parts_count_as_0():
    found = cost(a=1.5, b=2.0)
    assert part_seconds(found, "a", "b", "c") == 3.5
    assert part_seconds(found) == 0


def test_seconds_per_view_are_those_of_rendering_alone():
    assert seconds_per_view(cost({"views": 4}, render=10.0, prepare=99.0)) == 2.5
    with pytest.raises(KeyError, match="render"):
        seconds_per_view(cost({"views": 4}, prepare=99.0))


def test_learning_leaves_out_the_search_for_the_number_of_gaussians():
    assert learning_seconds(cost(initialization=7.0, training=3.0)) == 3
    assert learning_seconds(cost(initialization=7.0, training=3.0, stream=4.0)) == 7


def test_targets_are_radius_points_and_passes():
    facts = {"seconds_per_target_pass": 0.25}
    parts = {"radius": 2.0, "points": 1.0, "train/front": 50.0, "probe": 8.0}
    assert target_seconds(cost(facts, **parts), passes=40) == 2 + 1 + 10
    with pytest.raises(KeyError, match="seconds_per_target_pass"):
        target_seconds(cost({}, **parts), passes=40)
    with pytest.raises(KeyError, match="points"):
        target_seconds(cost(facts, radius=2.0), passes=40)


def test_passes_that_were_done():
    reference = cost({"passes_done": {"train": 25}})
    assert passes_done(reference, "train", 200) == 25
    assert passes_done(reference, "more", 200) == 200
    assert passes_done({}, "train", 200) == 200

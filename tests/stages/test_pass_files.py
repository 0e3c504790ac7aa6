"""Sums of passes in parts: made in any order and by anybody, they add up to the same bits."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from gpf.core.errors import UserError
from gpf.sppm.passes import PassSettings
from stages.references.pass_files import PassParts
from stages.references.pass_sums import PassSums
from stages.references.renderer import ReferenceRenderer
from stages.references.view_samples import fixed_points
from tests.furnace import camera, cornell_box

SETTINGS = PassSettings(photons_per_pass=3000, initial_radius=0.1, direct="photons")
COSTS = {"wall_seconds": 1.5}


@pytest.fixture(scope="module")
def renderer() -> ReferenceRenderer:
    box = cornell_box(glass=True)
    sensor = mi.load_dict(camera((0, -0.2, 3.6), (0, 0, 0), 45, (8, 6)))
    del box["sensor"]
    scene = mi.load_dict(box)
    points = {"floor": fixed_points(scene, sensor, "floor", SETTINGS, 3)}
    return ReferenceRenderer(scene, {"front": sensor}, points, SETTINGS, 3)


def render(renderer: ReferenceRenderer, passes: range) -> PassSums:
    sums = renderer.empty_sums()
    for t in passes:
        renderer.run_pass(t + 1, sums)
    return sums


def parts_in(folder, seed: int = 3, passes: int = 1000) -> PassParts:
    return PassParts(folder, {"seed": seed, "size": (8, 6)}, passes)


def touch(parts: PassParts, *ranges: tuple[int, int]) -> None:
    for a, b in ranges:
        path = parts.file(range(a, b))
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()


def test_parts_add_up_to_the_same_bits(renderer, tmp_path):
    sums = render(renderer, range(7))
    expected = renderer.image("front", sums), renderer.mean_irradiance("floor", sums)
    parts = parts_in(tmp_path)
    for part in (range(4, 7), range(1), range(1, 4)):
        parts.write(part, render(renderer, part), COSTS)
    sums = renderer.empty_sums()
    for part in parts.done():
        assert parts.add_to(sums, part) == COSTS
    assert sums.passes == 7
    np.testing.assert_array_equal(renderer.image("front", sums), expected[0])
    np.testing.assert_array_equal(renderer.mean_irradiance("floor", sums), expected[1])
    assert expected[0].mean() > 0.05 and expected[1].mean() > 0.05


def test_parts_of_a_longer_sum_are_left_alone(tmp_path):
    short, long = parts_in(tmp_path, passes=250), parts_in(tmp_path)
    touch(long, (0, 100), (100, 300), (300, 640))
    assert short.done() == [range(100)]
    assert short.missing(range(250)) == [range(100, 250)]
    touch(short, (100, 250))
    assert short.done() == [range(100), range(100, 250)]
    assert long.done() == [range(100), range(100, 300), range(300, 640)]


@pytest.mark.parametrize("threads", [1, 3])
def test_the_number_of_threads_changes_no_bit(renderer, threads):
    import drjit as dr

    before = dr.thread_count()
    expected = render(renderer, range(2)).tensors()
    dr.set_thread_count(threads)
    try:
        for name, array in render(renderer, range(2)).tensors().items():
            np.testing.assert_array_equal(array, expected[name], err_msg=name)
    finally:
        dr.set_thread_count(before)


def test_what_is_missing_ends_at_the_cuts(tmp_path):
    parts = parts_in(tmp_path)
    assert parts.done() == [] and parts.missing(range(5)) == [range(5)]
    touch(parts, (3, 10), (20, 30))
    assert parts.done() == [range(3, 10), range(20, 30)]
    assert parts.missing(range(40)) == [range(3), range(10, 20), range(30, 40)]
    assert parts.missing(range(40), cuts=[1, 5, 15, 40]) == [
        range(1),
        range(1, 3),
        range(10, 15),
        range(15, 20),
        range(30, 40),
    ]
    assert parts.missing(range(5, 25)) == [range(10, 20)]
    assert parts.missing(range(4, 9)) == []
    assert parts.missing(range(12, 14)) == [range(12, 14)]


def test_no_pass_counts_twice(tmp_path):
    parts = parts_in(tmp_path)
    touch(parts, (0, 10), (0, 4), (5, 20), (10, 15), (40, 41))
    assert parts.done() == [range(10), range(10, 15), range(40, 41)]
    assert parts.missing(range(30)) == [range(15, 30)]


def test_a_growing_part_replaces_itself(renderer, tmp_path):
    parts, sums = parts_in(tmp_path), renderer.empty_sums()
    for last in (2, 3, 5):
        parts.write(range(2, last), sums, COSTS)
    parts.write(range(20, 21), sums, COSTS)
    assert sorted(p.name for p in parts.folder.iterdir()) == [
        "2-5.safetensors",
        "20-21.safetensors",
        "fingerprint.json",
    ]


def test_parts_of_something_else_are_left_alone(renderer, tmp_path):
    mine, other = parts_in(tmp_path), parts_in(tmp_path, seed=4)
    other.write(range(10), renderer.empty_sums(), COSTS)
    touch(parts_in(tmp_path, seed=5), (0, 10))
    unknown = parts_in(tmp_path, seed=5).folder
    assert mine.done() == []
    assert mine.others() == {
        other.folder: "other seed (4, not 3)",
        unknown: "an unknown fingerprint",
    }


def test_fingerprints_are_compared_as_json(tmp_path):
    """What was a tuple when it was written is a list when it is read."""
    as_list = PassParts(tmp_path, {"size": [8, 6], "seed": 3}, 1000)
    assert as_list.digest == parts_in(tmp_path).digest


def test_a_truncated_part_is_an_error_in_words(renderer, tmp_path):
    parts = parts_in(tmp_path)
    parts.write(range(1), render(renderer, range(1)), COSTS)
    file = parts.file(range(1))
    file.write_bytes(file.read_bytes()[:-40])
    with pytest.raises(UserError, match=r"0-1\.safetensors: is truncated.*make it again"):
        parts.add_to(renderer.empty_sums(), range(1))


def test_a_part_in_the_wrong_folder_is_refused_by_name(renderer, tmp_path):
    """Brought from another machine that had other parameters."""
    mine, other = parts_in(tmp_path), parts_in(tmp_path, seed=4)
    other.write(range(3), renderer.empty_sums(), COSTS)
    mine.folder.mkdir()
    other.file(range(3)).rename(mine.file(range(3)))
    kept = mine.file(range(3)).read_bytes()
    with pytest.raises(UserError, match=rf"0-3\.safetensors: holds.*{other.digest}.*Move it out"):
        mine.add_to(renderer.empty_sums(), range(3))
    assert mine.file(range(3)).read_bytes() == kept

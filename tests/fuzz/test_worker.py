"""What a worker takes for a fault."""

from __future__ import annotations

import tempfile
from pathlib import Path

import pytest

from tests.fuzz.case import Case
from tests.fuzz.worker import Watch, judge

CASE = Case(("render", "scene.xml", "--spp", "1"), ("pictures/*",), ("view '",))


@pytest.mark.parametrize(
    ("code", "text", "changed", "outcome"),
    [
        (0, "", set(), "worked"),
        (0, "", {"pictures/a.png"}, "worked"),
        (0, "", {"pictures/a.png", "scene.xml"}, "outside"),
        (2, "error: scene.xml: has no lamp. Add one.", set(), "refused"),
        (2, "looking error: --spp: is 0. Give more.", set(), "refused"),
        (2, "Usage: gpf render", set(), "refused"),
        (2, "error: something: is wrong. Look.", set(), "unnamed"),
        (2, "scene.xml", set(), "unnamed"),
        (2, "error: scene.xml: Traceback (most recent call last)", set(), "traceback"),
        (1, "error: scene.xml: has no lamp. Add one.", set(), "exit code"),
    ],
)
def test_outcomes(code, text, changed, outcome):
    assert judge(CASE, code, text, changed)[0] == outcome


def test_what_is_written_outside_of_a_folder_is_heard(tmp_path):
    inside, outside = tmp_path / "inside", tmp_path / "outside"
    inside.mkdir()
    watch = Watch()
    watch.folder = inside
    try:
        (inside / "a").write_text("fine")
        (inside / "a").read_text()
        Path("/dev/null").write_text("fine")
        assert watch.outside == []
        outside.mkdir()
        (outside / "b").write_text("not fine")
        (inside / "a").rename(outside / "a")
        tempfile.mkstemp(dir=outside, prefix="c")
        (inside / ".." / "d").write_text("not fine")
        (outside / "a").read_text()
    finally:
        watch.folder = None
    events = [event.partition(" ")[0] for event in watch.outside]
    assert events == ["os.mkdir", "open", "os.rename", "open", "open"]

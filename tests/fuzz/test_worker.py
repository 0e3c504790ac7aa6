"""What a worker takes for a fault."""

from __future__ import annotations

import os
import tempfile
import time
from pathlib import Path

import pytest

from tests.fuzz.case import Case
from tests.fuzz.runner import Runner
from tests.fuzz.worker import Outcome, judge, the_watch

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
    with the_watch().over(inside) as heard:
        (inside / "a").write_text("fine")
        (inside / "a").read_text()
        Path("/dev/null").write_text("fine")
        assert heard == []
        outside.mkdir()
        (outside / "b").write_text("not fine")
        (inside / "a").rename(outside / "a")
        tempfile.mkstemp(dir=outside, prefix="c")
        (inside / ".." / "d").write_text("not fine")
        (outside / "a").read_text()
    (outside / "e").write_text("nobody listens")
    assert [event.partition(" ")[0] for event in heard] == [
        "os.mkdir",
        "open",
        "os.rename",
        "open",
        "open",
    ]


def misbehave(case: Case, folder: Path) -> Outcome:
    if case.words == ("end",):
        os.abort()
    if case.words == ("wait",):
        time.sleep(1000)
    return "worked", ""


def test_a_case_that_ends_or_stops_its_worker_is_noticed(tmp_path):
    runner = Runner(tmp_path, misbehave, patience=5)
    endings = [runner.outcome(Case((word,))) for word in ("go", "end", "go", "wait", "go")]
    runner.stop()
    assert [outcome for outcome, _ in endings] == ["worked", "crash", "worked", "hang", "worked"]
    assert endings[1][1].startswith("Fatal Python error: Aborted")

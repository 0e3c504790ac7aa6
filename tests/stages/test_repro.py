"""`gpf repro`: progress of the whole, failures, and going on after Ctrl-C."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import time
from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console

from stages.progress import RELAY, progress_bar, read_relayed
from stages.repro import Run, _span
from stages.repro_plan import OVERHEAD, Durations, Plan, read_graph
from tests.stages.conftest import HEARING, Project

GRAPH = """\
strict digraph {
"scene@a";
"train@a";
"render@a";
"scene@b";
"train@b";
"render@b";
"report";
"scene@a" -> "train@a";
"train@a" -> "render@a";
"scene@b" -> "train@b";
"train@b" -> "render@b";
"render@a" -> "report";
"render@b" -> "report";
}
"""

# --- the plan ---------------------------------------------------------------------------------


@pytest.fixture
def plan() -> Plan:
    return Plan(read_graph(GRAPH), frozenset({"train@b"}))


def test_what_comes_after_a_stage_that_runs_will_run(plan):
    assert plan.left([], []) == ["train@b", "render@b", "report"]
    assert plan.left(["train@b"], ["scene@a"]) == ["render@b", "report"]
    # It ran, but left the same as before: what follows did not change.
    assert plan.left(["train@b"], ["render@b"]) == []
    assert plan.left(["train@b", "render@b"], []) == ["report"]


def test_what_new_code_concerns_is_known_before(plan):
    """All depend on the stage `code`, but only those are out of date whose own code changed."""
    edges = "".join(f'"code" -> "{name}";\n' for name in plan.before)
    graph = read_graph(GRAPH.replace("}\n", f'"code";\n{edges}}}\n'))
    assert Plan(graph, frozenset({"code"})).left([], []) == ["code"]
    both = Plan(graph, frozenset({"code", "train@b"}))
    assert set(both.left([], [])) == {"code", "train@b", "render@b", "report"}
    assert set(both.left(["code"], [])) == {"train@b", "render@b", "report"}


def write_cost(root: Path, name: str, seconds: float) -> None:
    file = root / f"{name}.json"
    file.parent.mkdir(parents=True, exist_ok=True)
    halves = {"wall_seconds": seconds - 1, "cpu_seconds": 99.0, "compile_seconds": 1.0}
    file.write_text(json.dumps({"parts": {"x": halves}, "facts": {}}))


def test_durations_are_those_of_earlier_runs(tmp_path):
    write_cost(tmp_path, "a/costs/train", 10)
    write_cost(tmp_path, "a/costs/baselines/path_10", 20)
    write_cost(tmp_path, "b/costs/ablations/k_1", 30)
    (tmp_path / "b/costs/train.json").write_text("{")
    stages = ["train@a", "train@b", "classical@a-path_10", "ablation@b-k_1", "report", "photons@a"]
    durations = Durations.read(stages, tmp_path)
    assert durations.earlier == {
        "train@a": 10 + OVERHEAD,
        "classical@a-path_10": 20 + OVERHEAD,
        "ablation@b-k_1": 30 + OVERHEAD,
        "report": OVERHEAD,
    }
    assert durations.expect("photons@a") is None


def test_durations_are_corrected_by_what_ran():
    durations = Durations({"train@a": 10, "train@b": 20, "render@b": 4, "classical@a-p": 6})
    assert durations.expect("train@b") == 20
    assert durations.expect("train@c") == 15  # as long as others of its kind
    assert durations.expect("classical@b-q") == 6
    durations.now["train@a"] = 30  # three times as long as before
    assert durations.expect("train@b") == 60
    assert durations.expect("render@b") == 12
    assert durations.expect("train@c") == 30
    durations.now["classical@b-q"] = 1
    assert durations.expect("classical@c-p") == 18  # the same row before, corrected
    assert durations.expect("classical@c-q") == 1


# --- what is told -----------------------------------------------------------------------------


def told(plan: Plan, earlier: dict[str, float], *lines: str) -> tuple[Run, str]:
    text = StringIO()
    run = Run(plan, Durations(earlier), Console(file=text, width=200))
    for line in lines:
        run.see(line)
    return run, text.getvalue()


def test_a_stage_its_place_and_the_time_left(plan):
    run, text = told(
        plan,
        {"train@b": 600, "render@b": 130, "report": 20},
        "Stage 'scene@a' didn't change, skipping",
        "Stage 'scene@b' is cached - skipping run, checking out outputs",
        "Running stage 'train@b':",
    )
    assert text == "[3/7] train@b; about 12 min left\n"
    run.current_since -= 1200  # it takes twice as long as it did
    run.see("Running stage 'render@b':")
    assert run.ran == ["train@b"] and run.current == "render@b"
    assert run.time_left() == "about 5 min left"


def test_bars_of_a_stage_are_shown_beside_it(plan, monkeypatch, capfd):
    monkeypatch.setenv(RELAY, "1")
    monkeypatch.setattr("stages.progress.RELAY_SECONDS", -1.0)
    with progress_bar("b: training", 4) as bar:
        bar(1)
        bar.describe("b: last steps")
        bar(2, 8)
    lines = capfd.readouterr().err.split("\n")
    relayed = [read_relayed(line) for line in lines if read_relayed(line)]
    assert relayed == ["b: training 1/4", "b: last steps 2/8"]
    console = Console(file=StringIO(), width=200, force_terminal=True)
    run = Run(plan, Durations({"report": 70}), console)
    run.see("Running stage 'train@b':")
    run.inside = relayed[-1]
    assert run.line() == "[1/7] train@b 0 s; more than 70 s left | b: last steps 2/8"


def test_unknown_times_are_not_made_up(plan):
    run, _ = told(plan, {}, "Running stage 'train@b':")
    assert run.time_left() == "time left not known yet"
    run, _ = told(plan, {"report": 70}, "Running stage 'train@b':")
    assert run.time_left() == "more than 70 s left"


def test_what_a_stage_that_failed_said_is_shown_and_no_more(plan):
    run, text = told(
        plan,
        {},
        "Running stage 'train@b':",
        "> gpf stage train --scene b",
        "said before",
        "Running stage 'render@b':",
        *(f"line {k}" for k in range(50)),
        "[weird] markup stays",
        "ERROR: failed to reproduce 'render@b': failed to run: gpf, exited with 2",
    )
    shown = text.partition("render@b failed\n")[2].splitlines()
    assert "said before" not in text
    assert shown[0] == "  line 11" and shown[-2] == "  [weird] markup stays"
    assert shown[-1].startswith("  ERROR: failed to reproduce 'render@b'")
    assert run.failed == ["render@b"] and run.ran == ["train@b"]


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0.4, "0 s"), (99.4, "99 s"), (100, "2 min"), (5400, "90 min"), (3600 * 3.5, "3 h 30 min")],
)
def test_spans(seconds, text):
    assert _span(seconds) == text


# --- with DVC ---------------------------------------------------------------------------------

PIPELINE = """\
stages:
  first:
    foreach: [a, b]
    do:
      cmd: echo hello ${item} && cp source-${item} first-${item}
      deps: ["source-${item}"]
      outs: ["first-${item}"]
  second:
    matrix: {scene: [a, b], row: [x]}
    cmd: echo words of ${item.scene} && sh work.sh first-${item.scene} second-${item.scene}
    deps: ["first-${item.scene}", work.sh]
    outs: ["second-${item.scene}"]
"""


@pytest.fixture
def small(tmp_path: Path) -> Project:
    """A project of DVC with nothing of this one in it."""
    pytest.importorskip("dvc")
    folder = tmp_path / "small"
    folder.mkdir()
    (folder / "dvc.yaml").write_text(PIPELINE)
    (folder / "work.sh").write_text('cp "$1" "$2"\n')
    for name in "ab":
        (folder / f"source-{name}").write_text(name)
    command = [sys.executable, "-m", "dvc", "init", "--no-scm", "--quiet"]
    subprocess.run(command, cwd=folder, check=True)
    return Project(folder)


def test_failing_and_going_on(small):
    bar = "printf '\\0361/2 a bar\\n'"
    work = f'{bar}; test "$1" = first-a && cp "$1" "$2" || exit 7\n'
    (small.folder / "work.sh").write_text(work)
    outcome = small.gpf("repro")
    assert outcome.code == 255  # DVC's own
    assert re.search(r"\[\d/4\] first@a: \d+ s", outcome.text), outcome.text
    assert "second@b-x failed" in outcome.text and "words of b" in outcome.text
    assert "exited with 7" in outcome.text and "hello a" not in outcome.text
    assert "failed after 3 of 4 stages" in outcome.text
    log = (small.folder / "results" / "repro.log").read_text()
    assert {"hello a", "hello b", "words of a", "words of b"} <= set(log.splitlines())
    assert "a bar" not in log + outcome.text

    (small.folder / "work.sh").write_text('cp "$1" "$2"\n')
    outcome = small.gpf("repro", "second@b-x")
    assert outcome.code == 0 and "[2/2] second@b-x" in outcome.text
    assert "done: 1 stages ran, 1 were up to date" in outcome.text

    assert small.gpf("repro", "thrid").code == 255


def test_a_dry_run_runs_nothing_and_says_so(small):
    outcome = small.gpf("repro", "--dry", "first@a")
    assert outcome.code == 0 and "stages ran" not in outcome.text
    assert not (small.folder / "first-a").exists() and not (small.folder / "results").exists()


def test_ctrl_c_and_going_on(small, environment):
    (small.folder / "work.sh").write_text(
        'if [ -e again ]; then cp "$1" "$2"; else touch here; sleep 60; fi\n'
    )
    with subprocess.Popen(
        [sys.executable, "-c", HEARING, "repro"],
        cwd=small.folder,
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    ) as process:
        deadline = time.monotonic() + 120
        while not (small.folder / "here").exists():
            assert time.monotonic() < deadline and process.poll() is None
            time.sleep(0.05)
        started = time.monotonic()
        process.send_signal(signal.SIGINT)
        text, _ = process.communicate(timeout=120)
        assert time.monotonic() - started < 40  # it did not wait for the stage
        assert process.returncode == 130
    assert re.search(r"stopped after [12] of 4 stages.*goes on from there", text), text
    assert "failed" not in text and "Traceback" not in text

    (small.folder / "again").touch()
    outcome = small.gpf("repro")
    assert outcome.code == 0 and "were up to date" in outcome.text
    assert all((small.folder / f"second-{name}").read_text() == name for name in "ab")


def test_not_in_a_project(tmp_path):
    outcome = Project(tmp_path).gpf("repro")
    assert outcome.code == 2 and "dvc.yaml: is missing. Run `gpf repro` in" in outcome.text


def test_a_pipeline_that_dvc_cannot_read(small):
    (small.folder / "dvc.yaml").write_text("stages: {a: {cmd: }}\n")
    outcome = small.gpf("repro")
    assert outcome.code == 255 and "dvc.yaml" in outcome.text

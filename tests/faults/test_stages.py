"""Every stage, and everything that can go wrong: nothing is lost, and the next run ends as if
nothing had happened.

The moments are random: ``GPF_FAULT_SEED`` gives others, ``GPF_FAULT_MOMENTS`` more of them. All 20:
``GPF_FAULT_MOMENTS=20 make test-all ARGS=tests/faults``.
"""

from __future__ import annotations

import random
import signal

import pytest

from tests.faults.cases import stages
from tests.faults.runner import MOMENTS, SEED, SIGNALS, Fault, moment


@pytest.mark.slow
@stages(*range(MOMENTS))
def test_a_killed_stage_leaves_whole_files_and_goes_on(trials, tmp_path, stage, other):
    trial = trials(stage)
    fault = moment(stage, other, trial.well[0])
    trial.survives(tmp_path / "project", fault, lambda end: end.code in (0, -signal.SIGKILL))


@pytest.mark.slow
@stages(*SIGNALS)
def test_a_signal_ends_a_stage_in_words_and_it_goes_on(trials, tmp_path, stage, other):
    trial, signals = trials(stage), SIGNALS[other]
    chance = random.Random(f"{SEED} {stage} {other}")
    fault = Fault(signals=signals, after=chance.uniform(0.2, trial.well[0].seconds))

    def may_end(ending):
        return ending.code in (0, 130, -signals[0]) and "Traceback" not in ending.said

    trial.survives(tmp_path / "project", fault, may_end)


@pytest.mark.slow
@stages()
def test_a_limit_on_the_size_of_a_file(trials, tmp_path, stage):
    trial = trials(stage)
    largest = max(p.stat().st_size for p in trial.before.folder.glob("results/**/*.*"))
    for number in range(MOMENTS):
        chance = random.Random(f"{SEED} {stage} size {number}")
        fault = Fault(file_size=int(largest ** chance.uniform(0.3, 1)))
        folder = tmp_path / f"project-{number}"
        trial.survives(folder, fault, lambda end: end.code == 0 or end.is_in_words())


@pytest.mark.slow
@stages(turn=1)
def test_a_file_where_a_folder_was(trials, tmp_path, stage):
    trial = trials(stage)
    project = trial.before.copy(tmp_path / "project")
    place = project.folder / "results" / trial.case.folder
    place.rename(place.with_name("away"))
    place.write_text("a file")
    ending = trial.run(project)
    assert ending.code == 0 or ending.is_in_words(), ending.said
    if ending.code:
        assert place.read_text() == "a file"
        place.unlink()
        place.with_name("away").rename(place)
        trial.check(project)
        trial.finish(project)


@pytest.mark.slow
@stages(turn=2)
def test_a_clock_that_jumps(trials, tmp_path, stage):
    trials(stage).survives(tmp_path / "project", Fault(clock=True), lambda end: end.code == 0)

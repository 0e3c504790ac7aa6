"""Whatever is fed in, the commands work or say in words what is wrong.

`python -m tests.fuzz` runs all cases from a new seed, and one of them again by its number.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.fuzz import runner
from tests.fuzz.kinds import KINDS, SHARES
from tests.fuzz.runner import Ending, Tally, run_cases

SEED = 26

QUICK = {kind: 6 for kind in KINDS}


def check(tally: Tally, capsys: pytest.CaptureFixture[str]) -> None:
    """Print the table; there are no faults, and cases of each kind work."""
    with capsys.disabled():
        print(f"\nseed {SEED}\n{tally.table()}")
    assert not tally.faults, "\n".join(map(str, tally.faults))
    assert len(tally.endings) >= sum(QUICK.values())


def test_few_inputs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    check(run_cases(QUICK, SEED, tmp_path), capsys)


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_many_inputs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert sum(SHARES.values()) >= 2000
    tally = run_cases(SHARES, SEED, tmp_path)
    check(tally, capsys)
    for kind in KINDS:  # a generator of nothing but nonsense would find nothing
        outcomes = {ending.outcome for ending in tally.endings if ending.kind == kind}
        assert outcomes == {"worked", "refused"}, kind


STRANGE = """
import os, sys, time
from tests.fuzz import kinds
from tests.fuzz.case import Case

def make(rng, folder, good):
    number = int(folder.parent.name)
    if number == 1:
        os.abort()
    if number == 3:
        time.sleep(1000)
    return Case(("lights", "none.safetensors") if number != 5 else ("lights",) * 3)

kinds.KINDS["fields"] = make
sys.argv[0] = "worker"
from tests.fuzz.worker import main
main()
"""


def test_a_case_that_ends_or_stops_its_worker_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(runner, "WORKER", ("-c", STRANGE))
    monkeypatch.setattr(runner, "PATIENCE", 12.0)
    tally = run_cases({"fields": 6}, SEED, tmp_path)
    expected = ["refused", "crash", "refused", "hang", "refused", "refused"]
    assert [ending.outcome for ending in tally.endings] == expected
    assert [ending.number for ending in tally.faults] == [1, 3]
    assert "SIGABRT" in tally.faults[0].what
    assert "--kind fields --seed 26 --only 3" in str(tally.faults[1])


def test_the_table_counts_by_kind_and_outcome() -> None:
    endings = [("a", 0, "worked"), ("a", 1, "hang"), ("b", 0, "worked")]
    tally = Tally([Ending(kind, 1, number, outcome) for kind, number, outcome in endings])
    rows = [line.split() for line in tally.table().splitlines()]
    hang = rows[0].index("hang") - 1  # "exit code" has two words
    assert [row[:3] for row in rows[1:]] == [["a", "2", "1"], ["b", "1", "1"], ["all", "3", "2"]]
    assert [row[hang] for row in rows[1:]] == ["1", "0", "1"]

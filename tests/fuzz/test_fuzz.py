"""Whatever is fed in, the commands work or say in words what is wrong.

Each run tries the same cases; `pytest tests/fuzz --hypothesis-profile=default` others.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from tests.fuzz import archives, cameras, command_lines, fields, pipeline, scenes
from tests.fuzz.runner import Runner
from tests.fuzz.worker import GOOD

KINDS = {
    "scenes": scenes.imports(),
    "pictures": scenes.pictures(),
    "archives": archives.imports(),
    "cameras": cameras.cases(),
    "settings": pipeline.settings(),
    "fields": fields.cases(),
    "artifacts": pipeline.artifacts(),
    "commands": command_lines.cases(),
}
# Without `explain`, which tries a case that hangs again and again.
PHASES = [phase for phase in Phase if phase != Phase.explain]
# Of each kind, so many times ten cases: after ten, Hypothesis rather repeats what it has tried with
# small changes.
FEW, MANY = range(2), range(2, 26)


@pytest.fixture(scope="module")
def runner(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Runner]:
    runner = Runner(tmp_path_factory.mktemp("fuzz"))
    yield runner
    runner.stop()


@pytest.fixture
def outcomes() -> Iterator[set[str]]:
    """Of all cases of a test: a strategy of nothing but nonsense would find nothing."""
    found: set[str] = set()
    yield found
    assert found >= set(GOOD)


@pytest.mark.timeout(900)
@pytest.mark.parametrize("part", [*FEW, *(pytest.param(k, marks=pytest.mark.long) for k in MANY)])
@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=10, deadline=None, phases=PHASES, suppress_health_check=HealthCheck)
@given(data=st.data())
def test_inputs(kind, part, data, runner, outcomes):
    outcome, what = runner.outcome(data.draw(KINDS[kind]))
    outcomes.add(outcome)
    assert outcome in GOOD, f"{what[-3000:]}\nfiles: {runner.folder}"

"""The workflows fit the project, and the version is the same wherever it stands."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

import gpf

PROJECT = Path(__file__).parents[2]
FOLDER = PROJECT / ".github" / "workflows"
WORKFLOWS = {path.stem: YAML(typ="safe").load(path) for path in FOLDER.glob("*.yml")}
MAKE = re.compile(r"\bmake (?:[A-Z]+=\S+ )*([a-z-]+)")


def read(name: str) -> str:
    return (PROJECT / name).read_text(encoding="utf-8")


def steps(name: str) -> list[dict[str, Any]]:
    return [step for job in WORKFLOWS[name]["jobs"].values() for step in job.get("steps", ())]


def test_workflows_call_targets_of_the_makefile():
    targets = set(re.findall(r"^([a-z-]+):", read("Makefile"), re.MULTILINE))
    commands = [step.get("run", "") for name in WORKFLOWS for step in steps(name)]
    commands += [line for line in read(".ci/run").splitlines() if not line.startswith("#")]
    called = {target for command in commands for target in MAKE.findall(command)}
    assert called == {"lint", "docs", "venv", "test", "test-all", "repro"} and called <= targets


def test_each_test_is_in_one_shard():
    shards = WORKFLOWS["shards"]["jobs"]["tests"]["strategy"]["matrix"]["include"]
    places = [place for s in shards for path in s["paths"].split() for place in PROJECT.glob(path)]
    files = [[place] if place.is_file() else place.rglob("test_*.py") for place in places]
    there = sorted((PROJECT / "tests").rglob("test_*.py"))
    assert sorted(file for found in files for file in found) == there


@pytest.mark.parametrize("name", WORKFLOWS)
def test_a_workflow_reads_only_and_takes_actions_by_their_major_version(name):
    assert WORKFLOWS[name]["permissions"] == {"contents": "read"}
    writing = {job for job, does in WORKFLOWS[name]["jobs"].items() if "permissions" in does}
    assert writing == ({"publish"} if name == "release" else set())
    used = [step["uses"] for step in steps(name) if "uses" in step]
    assert (
        used and [action for action in used if not re.fullmatch(r"actions/\S+@v\d+", action)] == []
    )


def test_checks_run_on_each_version_of_python():
    classified = re.findall(r"Python :: (3\.\d+)", read("pyproject.toml"))
    assert WORKFLOWS["checks"]["jobs"]["quick"]["strategy"]["matrix"]["python"] == classified


def test_the_version_is_the_same_everywhere():
    newest = re.search(r"^## (\d\S*) \((\S+)\)$", read("CHANGELOG.md"), re.MULTILINE)
    citation = YAML(typ="safe").load(read("CITATION.cff"))
    assert newest is not None
    assert newest.groups() == (citation["version"], str(citation["date-released"]))
    assert newest[1] == gpf.__version__

"""How the results were made: machines, versions, commits, parameters and seeds."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from io import StringIO
from typing import Any

from ruamel.yaml import YAML

from gpf.core.files import read_json
from report.results import Results

UNKNOWN = "unknown"


@dataclass(frozen=True)
class Machine:
    """A machine with its software, and the stages that ran on it."""

    facts: dict[str, str]
    stages: list[str]


def list_machines(results: Results) -> list[Machine]:
    """All distinct machines, each with its stages."""
    used: dict[tuple[tuple[str, str], ...], list[str]] = {}
    for scene, stage, cost in _costs(results):
        machine = cost.get("machine", {})
        packages = machine.get("packages", {})
        facts = {
            "Processor": machine.get("cpu"),
            "Cores": machine.get("cores"),
            "GPU": machine.get("gpu") or "none",
            "Mitsuba variant": machine.get("variant"),
            "LLVM": machine.get("llvm"),
            "Python": machine.get("python"),
            **{name: version for name, version in sorted(packages.items())},
        }
        key = tuple((name, str(value or UNKNOWN)) for name, value in facts.items())
        used.setdefault(key, []).append(f"{scene}: {stage}")
    return [Machine(dict(key), stages) for key, stages in used.items()]


def list_commits(results: Results) -> dict[str, dict[str, str]]:
    """Stage -> scene -> the git commit of its run, 7 digits."""
    commits: dict[str, dict[str, str]] = {}
    for scene, stage, cost in _costs(results):
        commit = cost.get("machine", {}).get("commit") or UNKNOWN
        commits.setdefault(stage, {})[scene] = commit[:7] if commit != UNKNOWN else commit
    return commits


def list_seeds(results: Results) -> dict[str, int]:
    """Section of params.yaml -> its seed."""
    sections = results.params.model_dump()
    return {
        name: section["seed"]
        for name, section in sections.items()
        if isinstance(section, dict) and "seed" in section
    }


def write_params(results: Results) -> str:
    """All parameters as YAML, with the defaults of those that params.yaml leaves out."""
    stream = StringIO()
    yaml = YAML()
    yaml.default_flow_style = False
    yaml.dump(results.params.model_dump(mode="json"), stream)
    return stream.getvalue()


def _costs(results: Results) -> Iterator[tuple[str, str, Mapping[str, Any]]]:
    """Scene title, stage or method, and content of all cost files."""
    for scene in results.params.scenes:
        folder = results.root / scene / "costs"
        for path in sorted(folder.glob("*.json")):
            yield results.scene(scene).title, path.stem, read_json(path, dict[str, Any])
        for path in sorted(folder.glob("baselines/*.json")):
            title = results.methods.get(path.stem)
            if title:
                yield results.scene(scene).title, title, read_json(path, dict[str, Any])
        for path in sorted(folder.glob("ablations/*.json")):
            if results.params.ablations.asks_for(scene, path.stem):
                title = f"variant {path.stem}"
                yield results.scene(scene).title, title, read_json(path, dict[str, Any])

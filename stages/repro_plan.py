"""What `dvc repro` is going to do, and how long that takes: from DVC's graph and from costs."""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

# Besides what costs measure, every stage starts Python and hashes files, s.
OVERHEAD = 2.0

# Stages of one row of params.yaml, by the folder of their costs; and those that have none.
ROWS = dict.fromkeys(("classical", "equal_time", "learned"), "baselines") | {
    "ablation": "ablations"
}
WITHOUT_COSTS = ("code", "amortize", "report")

# The stage on which all others depend, each on a file of its own: which of these change, DVC knows
# before it runs, see `stages.repro`.
CODE = "code"

_EDGE = re.compile(r'^\s*"(.+)" -> "(.+)";$')
_NODE = re.compile(r'^\s*"([^"]+)";$')


class DvcFailed(Exception):
    """DVC cannot tell what is to be done: its words and exit code."""

    def __init__(self, text: str, code: int) -> None:
        super().__init__(text)
        self.code = code


@dataclass(frozen=True)
class Plan:
    """The stages that `dvc repro` will look at.

    Attributes
    ----------
    before: stage -> the stages that make what it takes.
    changed: stages that are out of date, whatever happens to those before them.
    """

    before: Mapping[str, frozenset[str]]
    changed: frozenset[str]

    @classmethod
    def read(cls, dvc: Sequence[str], arguments: Sequence[str]) -> Plan:
        """Ask DVC; ``arguments`` are those of `dvc repro`."""
        graph = read_graph(_ask([*dvc, "dag", "--dot"]))
        wanted = [n for n in graph for a in arguments if n == a or n.startswith(f"{a}@")]
        if wanted and {"-s", "--single-item"} & set(arguments):
            graph = {name: graph[name] & frozenset(wanted) for name in wanted}
        elif wanted:
            graph = {name: graph[name] for name in _closure(graph, wanted)}
        if {"-f", "--force"} & set(arguments):
            return cls(graph, frozenset(graph))
        status = json.loads(_ask([*dvc, "status", "--json"]) or "{}")
        return cls(graph, frozenset(graph) & frozenset(status))

    def left(self, ran: Collection[str], skipped: Collection[str]) -> list[str]:
        """Stages that will run, as far as one knows now: out of date, or after one that runs."""
        runs: dict[str, bool] = {}

        def will_run(name: str) -> bool:
            if name not in runs:
                parents = self.before[name] - {CODE}
                changes = [parent in ran or will_run(parent) for parent in parents]
                out_of_date = name in self.changed or any(changes)
                runs[name] = name not in ran and name not in skipped and out_of_date
            return runs[name]

        return [name for name in self.before if will_run(name)]


def read_graph(dot: str) -> dict[str, frozenset[str]]:
    """Stage -> stages right before it, from what `dvc dag --dot` prints."""
    before: dict[str, set[str]] = {}
    for line in dot.splitlines():
        if node := _NODE.match(line):
            before.setdefault(node[1], set())
        elif edge := _EDGE.match(line):
            before.setdefault(edge[1], set())
            before.setdefault(edge[2], set()).add(edge[1])
    return {name: frozenset(parents) for name, parents in before.items()}


def _closure(graph: Mapping[str, frozenset[str]], wanted: Sequence[str]) -> list[str]:
    found, waiting = set(), list(wanted)
    while waiting:
        name = waiting.pop()
        if name not in found:
            found.add(name)
            waiting += graph[name]
    return [name for name in graph if name in found]


def _ask(command: Sequence[str]) -> str:
    done = subprocess.run(command, capture_output=True, text=True, stdin=subprocess.DEVNULL)
    if done.returncode:
        raise DvcFailed((done.stdout + done.stderr).strip(), done.returncode)
    return done.stdout


@dataclass
class Durations:
    """How long stages take: what they cost before, corrected by how long they take now.

    Attributes
    ----------
    earlier: stage -> seconds, from the files of costs.
    now: stage -> seconds, of those that ran.
    """

    earlier: Mapping[str, float]
    now: dict[str, float] = field(default_factory=dict)

    @classmethod
    def read(cls, stages: Sequence[str], root: Path = Path("results")) -> Durations:
        """What the stages cost when they last ran."""
        known = {name: _seconds(root, name) for name in stages}
        return cls({name: seconds for name, seconds in known.items() if seconds is not None})

    def expect(self, stage: str) -> float | None:
        """Seconds that a stage will take: as before; else as those that are most like it; or None:
        nobody knows."""
        if stage in self.earlier:
            return self.earlier[stage] * self._pace
        for like in (_kind_and_row, _kind):
            for known, factor in ((self.now, 1.0), (self.earlier, self._pace)):
                alike = [s for name, s in known.items() if like(name) == like(stage)]
                if alike:
                    return factor * sum(alike) / len(alike)
        return None

    @property
    def _pace(self) -> float:
        """How much longer stages take than before: sizes may have changed, or the machine."""
        both = self.now.keys() & self.earlier.keys()
        if not both:
            return 1.0
        return sum(self.now[name] for name in both) / sum(self.earlier[name] for name in both)


def _kind(stage: str) -> str:
    return stage.partition("@")[0]


def _kind_and_row(stage: str) -> tuple[str, str]:
    kind, _, item = stage.partition("@")
    return kind, item.partition("-")[2]


def _seconds(root: Path, stage: str) -> float | None:
    """What a stage's file of costs says, s; None where it has not run."""
    kind, _, item = stage.partition("@")
    if kind in WITHOUT_COSTS:
        return OVERHEAD
    scene, _, row = item.partition("-")
    name = f"{ROWS[kind]}/{row}" if kind in ROWS else kind
    try:
        costs = json.loads((root / scene / "costs" / f"{name}.json").read_text(encoding="utf-8"))
        return OVERHEAD + sum(sum(_wall(part)) for part in costs["parts"].values())
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None


def _wall(part: Mapping[str, float]) -> tuple[float, float]:
    return part["wall_seconds"], part["compile_seconds"]

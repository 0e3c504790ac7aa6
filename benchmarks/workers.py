"""`python -m benchmarks.workers`: how much cluster workers speed up the references.

The stage `reference` of the Cornell box runs locally, and on Ray with one and two single-threaded
workers. For more workers, the time is predicted from the measured time of the tasks: groups of
views follow one after the other, and the tasks of each group are distributed over the workers.
"""

from __future__ import annotations

import math
import os
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table
from ruamel.yaml import YAML

from gpf.core.files import read_json
from gpf.core.yaml import load_yaml

SCENE, PASSES, PASSES_PER_TASK = "cornell_box", 200, 10
PREDICTED = (1, 2, 4, 8, 16, 32, 64)
PROJECT = Path(__file__).resolve().parent.parent


@dataclass(frozen=True)
class Run:
    """One run of the stage: seconds of the whole stage, and of the passes of each group."""

    seconds: float
    groups: list[float]


def run_stage(folder: Path, executor: str, workers: int) -> Run:
    """Render all references in a copy of the project."""
    project = folder / f"{executor}-{workers}"
    shutil.copytree(PROJECT / "scenes" / SCENE, project / "scenes" / SCENE)
    yaml, original = YAML(), PROJECT / "params.yaml"
    params = load_yaml(original.read_text(encoding="utf-8"), str(original), yaml)
    params["executor"], params["scenes"] = executor, [SCENE]
    params["cluster"] |= {"workers": workers, "threads": 1, "passes_per_task": PASSES_PER_TASK}
    params["reference"] |= {"passes": PASSES, "preview_seconds": 0}
    with (project / "params.yaml").open("w", encoding="utf-8") as file:
        yaml.dump(params, file)
    environment = os.environ | {"PYTHONPATH": str(PROJECT)}
    for stage in ("scene", "reference"):
        start = time.perf_counter()
        command = [sys.executable, "-m", "gpf.cli", "stage", stage, "--scene", SCENE]
        subprocess.run(command, cwd=project, env=environment, check=True, capture_output=True)
    seconds = time.perf_counter() - start
    costs = project / "results" / SCENE / "costs" / "reference.json"
    spent = {"train": 0.0, "novel": 0.0, "second_reference": 0.0, "probe": 0.0}
    for name, cost in read_json(costs)["parts"].items():
        group = name.partition("/")[0]
        if group in spent:
            spent[group] += cost["wall_seconds"] + cost["compile_seconds"]
    # The probe times single passes afterwards, always on one machine.
    return Run(seconds - spent.pop("probe"), list(spent.values()))


def predict(run: Run, workers: int) -> float:
    """Seconds with ``workers`` workers, from a run with one; only the passes get faster."""
    tasks = math.ceil(PASSES / PASSES_PER_TASK)
    rounds = math.ceil(tasks / workers)
    return run.seconds - sum(run.groups) + sum(group / tasks * rounds for group in run.groups)


def main() -> None:
    """Measure, predict, and print one table."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        local = run_stage(folder, "local", 1)
        runs = {n: run_stage(folder, "ray", n) for n in (1, 2)}
    table = Table("workers", "measured", "predicted", "speed-up over one")
    table.add_row("none (local, all cores)", f"{local.seconds:.0f} s", "", "")
    for n in PREDICTED:
        expected = predict(runs[1], n)
        measured = f"{runs[n].seconds:.0f} s" if n in runs else ""
        speed = runs[1].seconds / (runs[n].seconds if n in runs else expected)
        table.add_row(str(n), measured, f"{expected:.0f} s", f"{speed:.1f}")
    console = Console(width=100)
    console.print(
        f"{SCENE}: 3 groups of {PASSES} passes, {PASSES_PER_TASK} per task, single-threaded workers"
    )
    console.print(table)


if __name__ == "__main__":
    main()

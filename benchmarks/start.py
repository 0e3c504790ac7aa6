"""`python -m benchmarks.start [SCENE …]`: how long the first photons take to arrive.

For each scene, in a process of its own: the seconds for starting Python and gpf, loading the scene,
placing cameras, and the first pass of photons. Compiling the kernels counts if they are not in
Dr.Jit's cache yet; run it twice.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from itertools import pairwise
from pathlib import Path

from rich.console import Console
from rich.table import Table

import gpf
from benchmarks.check_scenes import SCENES, load
from gpf.core.runtime import choose_variant
from gpf.fitting.fit import FitProgress
from gpf.importing.placement import place_sensors
from gpf.scene.folders import list_scenes
from gpf.scene.load import load_scene_file
from gpf.scene.snapshot import snapshot_scene

STEPS = ("start", "load", "cameras", "first pass")


def main() -> None:
    """Print the table."""
    table = Table("scene", *STEPS, "total")
    choose_variant("auto")
    for name in sys.argv[1:] or [*list_scenes(), *SCENES]:
        with tempfile.TemporaryDirectory() as folder:
            if name not in SCENES:
                snapshot_scene(name, Path(folder) / name)
            command = [sys.executable, "-m", "benchmarks.start", "--one", name, folder]
            command.append(str(time.time()))
            line = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout
        seconds = json.loads(line.splitlines()[-1])
        table.add_row(name, *(f"{s:.1f}" for s in seconds), f"{sum(seconds):.1f}")
    Console(width=100).print(table)


def measure(name: str, folder: Path, begin: float) -> list[float]:
    """Seconds of each of :data:`STEPS`; ``folder`` has a copy of a scene of `scenes/`."""
    marks = [begin]

    def mark() -> None:
        marks.append(time.time())

    choose_variant("auto")
    mark()
    scene = load(name) if name in SCENES else load_scene_file(folder / name / "scene.xml")
    mark()
    sensors = place_sensors(scene)
    mark()

    def end(progress: FitProgress) -> None:
        raise KeyboardInterrupt

    try:
        gpf.fit(scene, sensors, callback=end)
    except KeyboardInterrupt:
        mark()
    return [after - before for before, after in pairwise(marks)]


if __name__ == "__main__":
    if sys.argv[1:2] == ["--one"]:
        print(json.dumps(measure(sys.argv[2], Path(sys.argv[3]), float(sys.argv[4]))))
    else:
        main()

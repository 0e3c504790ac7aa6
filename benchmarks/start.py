"""`python -m benchmarks.start [SCENE …]`: what passes before the first photon.

For each scene, in a process of its own: seconds until gpf is imported, the scene is loaded, cameras
are placed, and the first pass of photons is over. What the kernels take to compile counts if they
are not in Dr.Jit's cache yet; run it twice.
"""

from __future__ import annotations

import json
import subprocess
import sys
from itertools import pairwise

from rich.console import Console
from rich.table import Table

from benchmarks.check_scenes import SCENES
from gpf.scene.folders import list_scenes

STEPS = ("import", "load", "cameras", "first pass")


def main() -> None:
    """Print the table."""
    table = Table("scene", *STEPS, "together")
    for name in sys.argv[1:] or [*list_scenes(), *SCENES]:
        command = [sys.executable, "-m", "benchmarks.start", "--one", name]
        line = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout
        seconds = json.loads(line.splitlines()[-1])
        table.add_row(name, *(f"{s:.1f}" for s in seconds), f"{sum(seconds):.1f}")
    Console(width=100).print(table)


def measure(name: str) -> list[float]:
    """Seconds of each of :data:`STEPS`."""
    import time

    marks = [time.perf_counter()]

    def mark() -> None:
        marks.append(time.perf_counter())

    import gpf
    from gpf.core.runtime import choose_variant
    from gpf.fitting.fit import FitProgress, default_sensors

    choose_variant("auto")
    mark()
    from benchmarks.placement import open_scene

    scene, _, _ = open_scene(name)
    mark()
    sensors = default_sensors(scene)
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
        print(json.dumps(measure(sys.argv[2])))
    else:
        main()

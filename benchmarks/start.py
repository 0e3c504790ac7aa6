"""How long the first photons take to arrive."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from itertools import pairwise
from pathlib import Path

from rich.console import Console
from rich.table import Table

import gpf
from benchmarks import check_scenes, cli
from benchmarks.measured_scenes import BUILT, open_scene
from gpf.core.runtime import choose_variant
from gpf.fitting.fit import FitProgress
from gpf.placement.cameras import place_sensors
from gpf.scene.folders import list_scenes
from gpf.scene.snapshot import snapshot_scene

STEPS = ("start", "load", "cameras", "first pass")

IN_A_PROCESS = """
import sys
from benchmarks.start import measure
print(*measure(sys.argv[1], float(sys.argv[2])))
"""


def start(scenes: cli.Scenes = None) -> None:
    """How long the first photons take to arrive.

    For each scene, in a process of its own: the seconds for starting Python and gpf, loading the
    scene, placing cameras, and the first pass of photons. Compiling the kernels counts if they are
    not in Dr.Jit's cache yet; run it twice.
    """
    table = Table("scene", *STEPS, "total")
    for name in scenes or [*list_scenes(), *check_scenes.SCENES]:
        with tempfile.TemporaryDirectory() as folder:
            place = name
            if name not in BUILT and not name.endswith(".xml"):
                snapshot_scene(name, Path(folder) / name)
                place = f"{folder}/{name}/scene.xml"
            command = [sys.executable, "-c", IN_A_PROCESS, place, str(time.time())]
            line = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout
        seconds = [float(word) for word in line.splitlines()[-1].split()]
        table.add_row(name, *(f"{s:.1f}" for s in seconds), f"{sum(seconds):.1f}")
        Console(width=100).print(table)


def measure(name: str, begin: float) -> list[float]:
    """Seconds of each of :data:`STEPS` in a process that was started at ``begin``."""
    marks = [begin]

    def mark() -> None:
        marks.append(time.time())

    choose_variant()
    mark()
    scene = open_scene(name).scene
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

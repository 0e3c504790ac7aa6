"""Time and memory for more and more of each quantity."""

from __future__ import annotations

import atexit
import math
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np
import typer
from rich.console import Console
from rich.table import Table

import gpf
from benchmarks import cli
from benchmarks.glass_sphere import cornell_box, load_scene, untrained_field, untrained_volume
from gpf.core.runtime import choose_variant
from gpf.modelling.meshes import grid
from gpf.scene.folders import scene_folder
from gpf.sppm.passes import PassSettings
from scenes.modelling import shapes
from stages.common.costs import peak_memory
from stages.references.renderer import ReferenceRenderer

ROWS, PATHS, RADIUS = 256, 100_000, 0.02


class Cost(NamedTuple):
    """Seconds without loading and compiling, and the peak memory of the process, MB."""

    seconds: float
    megabytes: float


def render_pixels(pixels: int) -> Callable[[], object]:
    """A picture from a field of 50,000 Gaussians, 16 samples per pixel."""
    rows = math.isqrt(pixels)
    scene = load_scene(rows, rows)
    integrator = mi.load_dict({"type": "gpf"})
    integrator.field = untrained_field(scene, 50_000)
    return lambda: mi.render(scene, integrator=integrator, spp=16)


def sum_passes(passes: int) -> Callable[[], object]:
    """SPPM, 64² pixels."""
    return _sppm(load_scene(64, 64), PATHS // 10, passes)


def trace_paths(paths: int) -> Callable[[], object]:
    """Three passes of SPPM, 256² pixels."""
    return _sppm(load_scene(ROWS, ROWS), paths, 3)


def float_photons(paths: int) -> Callable[[], object]:
    """Three passes of SPPM in a box full of fog, 256² pixels."""
    return _sppm(load_scene(ROWS, ROWS, fog=True), paths, 3)


def query_volume(count: int) -> Callable[[], object]:
    """A picture of fog with ``count`` Gaussians in it, 16 samples per pixel."""
    scene = load_scene(ROWS, ROWS, fog=True)
    integrator = mi.load_dict({"type": "gpf"})
    integrator.field = untrained_field(scene, 50_000)

    def call() -> object:
        integrator.field.volume = untrained_volume(scene, count)
        return mi.render(scene, integrator=integrator, spp=16)

    return call


def query_gaussians(count: int) -> Callable[[], object]:
    """Gaussians from photons, their search, and a picture, 16 samples per pixel."""
    scene = load_scene(ROWS, ROWS)
    integrator = mi.load_dict({"type": "gpf"})

    def call() -> object:
        integrator.field = untrained_field(scene, count)
        return mi.render(scene, integrator=integrator, spp=16)

    return call


def load_triangles(count: int) -> Callable[[], object]:
    """Loading a rough ball of ``count`` triangles in the Cornell box, and a pass of SPPM."""

    def call() -> object:
        scene = mi.load_dict(cornell_box(ROWS, ROWS) | {"ball": _ball(count)})
        return _sppm(scene, PATHS, 1)()

    return call


def light_lamps(count: int) -> Callable[[], object]:
    """Three passes of SPPM under ``count`` spheres that emit light."""
    side = math.isqrt(count)
    places = [-0.8 + 1.6 * (k + 0.5) / side for k in range(side)]
    lamps = {
        f"lamp_{k}": {
            "type": "sphere",
            "center": [places[k // side], 0.9, places[k % side]],
            "radius": 0.3 / side,
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 5.0}},
        }
        for k in range(side**2)
    }
    return _sppm(mi.load_dict(cornell_box(ROWS, ROWS) | lamps), PATHS, 3)


def share_views(count: int) -> Callable[[], object]:
    """Three passes of SPPM for views that share their photons, 128² pixels each."""
    scene = load_scene(128, 128)
    sensors = {f"view {k}": scene.sensors()[0] for k in range(count)}
    settings = PassSettings(photons_per_pass=PATHS, initial_radius=RADIUS)
    renderer = ReferenceRenderer(scene, sensors, {}, settings, seed=1)
    return lambda: renderer.run(3)


def render_frames(count: int) -> Callable[[], object]:
    """Frames of a camera path, 64² pixels, with their files, by `gpf render`."""
    # A folder for each call: frames that exist are not rendered again.
    folder = Path(tempfile.mkdtemp())
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    scene_file = scene_folder("cornell_box") / "scene.xml"
    gpf.save_field(
        untrained_field(gpf.load_scene_file(scene_file), 50_000), folder / "field.safetensors"
    )
    options = ["--field", "field.safetensors", "--orbit", str(count), "--size", "64", "--spp", "4"]
    command = [sys.executable, "-m", "gpf.cli", "render", str(scene_file), *options]
    calls = iter(range(9))

    def call() -> object:
        out = ["--output", f"frames-{next(calls)}"]
        return subprocess.run([*command, *out], cwd=folder, check=True, capture_output=True)

    return call


@dataclass(frozen=True)
class Quantity:
    """What grows: three small sizes, and a large one that they predict."""

    prepare: Callable[[int], Callable[[], object]]
    small: tuple[int, int, int]
    large: int


QUANTITIES = {
    "pixels": Quantity(render_pixels, (256**2, 512**2, 1024**2), 4096**2),
    "passes": Quantity(sum_passes, (100, 300, 1000), 10_000),
    "photon paths": Quantity(trace_paths, (100_000, 300_000, 1_000_000), 10_000_000),
    "Gaussians": Quantity(query_gaussians, (30_000, 100_000, 300_000), 1_000_000),
    "photon paths in fog": Quantity(float_photons, (30_000, 100_000, 300_000), 3_000_000),
    "Gaussians in fog": Quantity(query_volume, (3_000, 10_000, 30_000), 300_000),
    "triangles": Quantity(load_triangles, (100_000, 300_000, 1_000_000), 10_000_000),
    "lamps": Quantity(light_lamps, (16, 64, 256), 1024),
    "views together": Quantity(share_views, (2, 4, 8), 32),
    "frames": Quantity(render_frames, (20, 60, 200), 2000),
}


def measure_here(name: str, size: int) -> Cost:
    """The cost of the second of two calls; the first one compiles."""
    choose_variant("auto")
    quantity = QUANTITIES[name]
    quantity.prepare(quantity.small[0])()
    call = quantity.prepare(size)
    start = time.perf_counter()
    dr.eval(call())
    dr.sync_thread()
    seconds = time.perf_counter() - start
    who = resource.RUSAGE_CHILDREN if name == "frames" else resource.RUSAGE_SELF
    return Cost(seconds, peak_memory(who) / 1e6)


def measure(name: str, size: int) -> Cost:
    """The cost of one size, in a process of its own."""
    code = f"from benchmarks.growth import measure_here; print(*measure_here({name!r}, {size}))"
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    return Cost(*map(float, done.stdout.splitlines()[-1].split()))


def predict(sizes: tuple[int, ...], costs: list[float], size: int) -> float:
    """What a line through the last two measurements predicts; never less than the last."""
    slope = max((costs[-1] - costs[-2]) / (sizes[-1] - sizes[-2]), 0.0)
    return costs[-1] + slope * (size - sizes[-1])


def row(name: str) -> list[str]:
    """Measure one quantity."""
    quantity = QUANTITIES[name]
    costs = [measure(name, size) for size in (*quantity.small, quantity.large)]
    cells = [name, f"{quantity.large:,}"]
    for unit, values in (("s", [c.seconds for c in costs]), ("MB", [c.megabytes for c in costs])):
        expected = predict(quantity.small, values[:-1], quantity.large)
        exponent = math.log(values[-1] / values[-2]) / math.log(quantity.large / quantity.small[-1])
        cells += [
            " ".join(f"{value:.3g}" for value in values[:-1]),
            f"{expected:.3g} {unit}",
            f"{values[-1]:.3g} {unit}",
            f"{values[-1] / expected:.2f}",
            f"{exponent:.2f}",
        ]
    return cells


def growth(
    names: Annotated[
        list[str] | None, typer.Argument(metavar="[NAME]…", help=f"Of: {', '.join(QUANTITIES)}.")
    ] = None,
) -> None:
    """How time and memory grow, and how predictably; all of it takes about ten minutes.

    For each quantity three small sizes are measured, and a large one, each in a process of its own.
    A line through the two larger of the small ones, a + b n, predicts the large one. The exponent
    p of n^p is the slope between the last two measurements on logarithmic axes. Memory is the peak
    of the process.
    """
    columns = ("small", "predicted", "measured", "ratio", "exponent")
    table = Table("", "large", *columns, *columns)
    for name in names or QUANTITIES:
        table.add_row(*row(name))
        Console(width=160).print(table)


def memory(rows: cli.Rows = 1024) -> None:
    """The peak memory of this process while it renders ROWS² pixels by SPPM."""
    call = _sppm(load_scene(rows, rows), PATHS, 3)
    before = peak_memory() / 1e6
    dr.eval(call())
    dr.sync_thread()
    now = peak_memory() / 1e6
    print(f"{rows}², {PATHS} paths per pass: {now:.0f} MB, {before:.0f} MB before rendering")


def _sppm(scene: mi.Scene, paths: int, passes: int) -> Callable[[], object]:
    sppm = {"type": "sppm", "photons_per_pass": paths, "initial_radius": RADIUS}
    integrator = mi.load_dict(sppm)
    return lambda: mi.render(scene, integrator=integrator, spp=passes)


def _ball(triangles: int) -> mi.Mesh:
    """A ball with bumps, so that no two triangles are alike."""
    rows = math.isqrt(triangles // 4)
    theta = np.linspace(np.pi - 0.01, 0.01, rows + 1)[:, None]
    phi = np.linspace(0, 2 * np.pi, 2 * rows, endpoint=False)[None]
    radius = 0.35 * (1 + 0.02 * np.sin(40 * theta) * np.sin(40 * phi))
    x, y = radius * np.sin(theta) * np.cos(phi), radius * np.cos(theta) + 0.2
    z = radius * np.sin(theta) * np.sin(phi)
    mesh = grid(np.stack([x, y + 0 * z, z], axis=-1), closed=True)
    return shapes.triangles(mesh, shapes.diffuse(shapes.WHITE))

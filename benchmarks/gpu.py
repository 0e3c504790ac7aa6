"""`make gpu`: whether everything works on a GPU, and how fast: tests, timings, one scene.

It needs a GPU that Dr.Jit finds but no network, and takes less than eight minutes: tests that are
still running after :data:`MINUTES_FOR_TESTS` are stopped. `make gpu VENV=python3` uses an
interpreter that has the packages already, on a machine without a network.
`make gpu ARGS='--variant llvm_ad_rgb'` runs the same on the CPU.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from pathlib import Path

import benchmarks.__main__ as bench
import gpf
from benchmarks.glass_sphere import PHOTONS, measure
from benchmarks.placement import open_scene
from gpf.core.errors import UserError
from gpf.core.images import write_png
from gpf.core.machine import device_description
from gpf.core.runtime import VARIANTS, choose_variant
from gpf.rendering.field_renderer import FieldRenderer
from gpf.rendering.settings import RenderSettings
from gpf.scene.folders import load_views
from gpf.scene.sensors import make_sensor
from metrics.image import psnr

FOLDERS = ("core", "scene", "photons", "camera", "sppm", "field", "training", "rendering")
"""Folders of tests whose kernels run on the GPU."""

MINUTES_FOR_TESTS = 4


def main() -> None:
    """Run everything, one part after another; exits with 1 unless all tests passed, 2 without a
    GPU."""
    parser = argparse.ArgumentParser(description="Tests, speed and one scene on a GPU")
    parser.add_argument("--variant", choices=VARIANTS, default="cuda_ad_rgb")
    parser.add_argument("--rows", type=int, default=1024, help="rows of the pictures")
    parser.add_argument("--seconds", type=float, default=30, help="seconds of the fit")
    parser.add_argument("--scene", default="water_caustic")
    parser.add_argument("--folders", nargs="*", default=FOLDERS, help="folders of tests")
    arguments = parser.parse_args()
    try:
        choose_variant(arguments.variant)
    except UserError as error:
        print(f"error: {error}", file=sys.stderr)
        raise SystemExit(2) from None
    print(device_description(), flush=True)
    # The scene comes first: it shows soonest whether anything works.
    fit_and_render(arguments.scene, arguments.rows, arguments.seconds)
    frames(arguments.rows)
    bench.main(arguments.variant)
    raise SystemExit(run_tests(arguments.folders))


def fit_and_render(name: str, rows: int, seconds: float) -> None:
    """One scene from end to end; its picture goes to results/gpu.png."""
    scene, _, aspect = open_scene(name)
    views = load_views(name)
    sensors = [make_sensor(view, round(rows // 4 * aspect), rows // 4) for view in views.train]
    start = time.perf_counter()
    field = gpf.fit(scene, sensors, seconds=seconds)
    print(f"{name}: fitted in {time.perf_counter() - start:.1f} s: {field}", flush=True)
    renderer = FieldRenderer.make(scene, field, RenderSettings())
    images = []
    for seed in range(3):  # the first one compiles
        start = time.perf_counter()
        size = round(rows * aspect), rows
        images.append(renderer.render(views.novel[0], size, seed)["radiance"])
        print(
            f"{name}: {rows} rows, {RenderSettings().spp} samples: "
            f"{time.perf_counter() - start:.2f} s",
            flush=True,
        )
    noise = psnr(images[1], images[2], views.exposure)
    print(f"{name}: two renders differ by {noise:.1f} dB", flush=True)
    write_png(Path("results/gpu.png"), images[2], views.exposure)


def frames(rows: int) -> None:
    """Print frames and passes per second, also for Mitsuba's own integrators."""
    timings = measure(rows, radius=0.02)
    for method in ("path", "ptracer", "sppm", "gpf", "gpf, recorded"):
        spent = timings.milliseconds(method)
        size = f"{PHOTONS} paths" if method == "ptracer" else f"{rows}²"
        print(f"{method}, {size}: {1e3 / spent:.1f} a second", flush=True)


def run_tests(folders: list[str]) -> int:
    """Run the quick tests in some folders; returns their exit code, or 1 if they took too long."""
    paths = [f"tests/{folder}" for folder in folders]
    command = [sys.executable, "-m", "pytest", "-q", "-m", "not slow", "-p", "no:cacheprovider"]
    try:
        return subprocess.run([*command, *paths], timeout=60 * MINUTES_FOR_TESTS).returncode
    except subprocess.TimeoutExpired:
        print(
            f"The tests were stopped after {MINUTES_FOR_TESTS} minutes, before all of them had run."
        )
        return 1


if __name__ == "__main__":
    main()

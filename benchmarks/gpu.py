"""`make gpu`: whether everything works on a GPU, and how fast: tests, timings, one scene.

It needs a GPU that Dr.Jit finds but no network, and takes less than eight minutes: tests that are
still running after :data:`MINUTES_FOR_TESTS` are stopped. `make gpu VENV=python3` uses an
interpreter that has the packages already, on a machine without a network.
`make gpu ARGS='--variant llvm_ad_rgb'` runs the same on the CPU.
"""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path
from typing import Annotated

import typer

import benchmarks.__main__ as bench
from benchmarks import cli
from benchmarks.measured_scenes import open_scene
from gpf.cli import run_app
from gpf.core.images import write_png
from gpf.core.machine import device_description
from gpf.core.runtime import VARIANTS, choose_variant
from gpf.rendering.field_renderer import FieldRenderer
from gpf.rendering.settings import RenderSettings
from metrics.image import psnr

FOLDERS = ["core", "scene", "photons", "camera", "sppm", "field", "training", "rendering"]
"""Folders of tests whose kernels run on the GPU."""

MINUTES_FOR_TESTS = 4


def gpu(
    variant: Annotated[str, typer.Option(help=", ".join(VARIANTS))] = "cuda_ad_rgb",
    rows: cli.Rows = 1024,
    seconds: cli.Seconds = 30,
    scene: str = "water_caustic",
    folders: Annotated[list[str], typer.Option(help="A folder of tests.")] = FOLDERS,
) -> None:
    """Tests, speed and one scene on a GPU; the exit code is 1 unless all tests passed, 2 without a
    GPU."""
    choose_variant(variant)
    print(device_description(), flush=True)
    # The scene comes first: it shows soonest whether anything works.
    fit_and_render(scene, rows, seconds)
    print(bench.pass_row(rows, radius=0.02))
    print(*bench.sample_rows(rows), sep="\n", flush=True)
    bench.bench()
    raise typer.Exit(run_tests(folders))


def fit_and_render(name: str, rows: int, seconds: float) -> None:
    """One scene from end to end; its picture goes to results/gpu.png."""
    measured = open_scene(name)
    start = time.perf_counter()
    field = measured.fit(measured.training_views, rows // 4, seconds=seconds)
    print(f"{name}: fitted in {time.perf_counter() - start:.1f} s: {field}", flush=True)
    renderer = FieldRenderer.make(measured.scene, field, RenderSettings())
    images = []
    for seed in range(3):  # the first one compiles
        start = time.perf_counter()
        view = measured.judged_views[0]
        images.append(renderer.render(view, measured.size(rows), seed)["radiance"])
        print(
            f"{name}: {rows} rows, {RenderSettings().spp} samples: "
            f"{time.perf_counter() - start:.2f} s",
            flush=True,
        )
    noise = psnr(images[1], images[2], measured.exposure)
    print(f"{name}: two renders differ by {noise:.1f} dB", flush=True)
    write_png(Path("results/gpu.png"), images[2], measured.exposure)


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
    run_app(cli.make_app(gpu))

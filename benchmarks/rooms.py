"""The field and other methods in scenes made by others."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import mitsuba as mi
import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from baselines.denoised.baseline import Denoised
from baselines.options import DenoisedOptions
from baselines.protocol import Task
from benchmarks import cli
from benchmarks.measured_scenes import MeasuredScene, open_scene
from benchmarks.truth import Truth, decibels, keep, path_halves, sppm
from gpf.field.field import GaussianPhotonField
from gpf.rendering.field_renderer import FieldRenderer
from gpf.rendering.settings import RenderSettings
from gpf.rendering.timed_sampling import time_of
from gpf.scene.views import View

UNLIMITED = {"type": "path", "max_depth": -1, "rr_depth": 5}

SAMPLES = 8
"""Samples per pixel that are rendered at once to time one."""


@dataclass(frozen=True)
class Room:
    """A scene, the views that are rendered, which of them are judged, and their truth."""

    measured: MeasuredScene
    file: Path
    views: Sequence[View]
    judged: Sequence[int]
    rows: int
    truth: Truth


def rooms(
    files: Annotated[list[Path], typer.Argument(help="Scene files.")],
    seconds: cli.Seconds = 60,
    passes: Annotated[
        int | None, typer.Option(help="Passes of the fit, however long they take.")
    ] = None,
    rows: cli.Rows = 256,
    views: Annotated[int, typer.Option(min=1, help="Number of views to render.")] = 10,
    judged: Annotated[int, typer.Option(min=1, help="Number of views to judge.")] = 3,
    samples: cli.Samples = 1024,
    kept: cli.Kept = Path("results/rooms"),
) -> None:
    """Field, `path` with a denoiser, and SPPM, with the same time for all views together.

    A field is fitted, and some views of it are rendered, the scene's own among them, denoised as by
    `gpf render`; then `path` with Open Image Denoise, and SPPM, each with as much time as the fit
    and the views took. A few views are judged against two independent images by `path`: PSNR over
    all their pixels, FLIP, and energy, the sum of the image divided by that of the truth, without
    the brightest half percent of the pixels of either. Below the table: the fit, and the time of a
    sample, compared with `path` without a depth limit.
    """
    for file in files:
        room = open_room(file, rows, views, judged, samples, kept)
        goal = {"passes": passes} if passes else {"seconds": seconds}
        compare(room, goal, kept)


def open_room(file: Path, rows: int, count: int, judged: int, samples: int, kept: Path) -> Room:
    """A scene with its own camera and others that are placed around it."""
    measured = open_scene(str(file))
    views = [measured.own, *measured.placed.novel, *measured.placed.frames()[3::6]][:count]
    chosen = np.linspace(0, len(views) - 1, judged).round().astype(int).tolist()
    sensors = measured.sensors([views[k] for k in chosen], rows)
    found = keep(
        kept / f"{measured.name}_{rows}_{judged}_{samples}.npz",
        lambda: {"halves": path_halves(measured.name, measured.scene, sensors, samples)},
    )
    truth = Truth(found["halves"], measured.exposure)
    return Room(measured, file, views, chosen, rows, truth)


def compare(room: Room, goal: dict[str, Any], kept: Path) -> None:
    """Print the table of one room."""
    name, truth = room.measured.name, room.truth
    table = Table("method", "total s", "PSNR", "FLIP", "energy", title=name)

    def add(method: str, images: np.ndarray) -> None:
        quality = decibels(truth.errors(images).mean()), f"{truth.flip(images):.3f}"
        table.add_row(method, f"{total:.0f}", *quality, f"{truth.energy(images):.3f}")

    start = time.perf_counter()
    field = room.measured.fit(**goal)
    fitted = time.perf_counter()
    settings = RenderSettings(denoise=True)
    images = room.measured.render(field, room.views, room.rows, settings)
    total = time.perf_counter() - start
    add("field", images[room.judged])
    add("path + OIDN", render_denoised(room, total / len(room.views), kept))
    add("SPPM", render_photons(room, total))
    console = Console(width=100)
    console.print(table)
    console.print(describe(room, field, (total - fitted + start) / len(room.views)))


def render_denoised(room: Room, seconds: float, state: Path) -> np.ndarray:
    """The judged views by `path` and Open Image Denoise, in ``seconds`` seconds each."""
    task = Task(
        room.measured.name,
        room.measured.scene,
        room.file,
        room.measured.size(room.rows),
        room.truth.exposure,
        training=(),
        rr_depth=5,
        seed=0,
        state=state,
        seconds_per_view=seconds,
    )
    prepared = Denoised(DenoisedOptions(system="denoised", spp="equal_time")).prepare(task)
    return np.stack([prepared.render(room.views[k], seed=k) for k in room.judged])


def render_photons(room: Room, seconds: float) -> np.ndarray:
    """The judged views by SPPM, in ``seconds`` seconds for all views together."""
    renderer = sppm(room.measured.scene, room.measured.sensors(room.views, room.rows))
    sums, end = renderer.empty_sums(), time.perf_counter() + seconds
    while time.perf_counter() < end:
        renderer.run_pass(sums.passes + 1, sums)
    return np.stack([renderer.image(f"{k}", sums) for k in room.judged])


def describe(room: Room, field: GaussianPhotonField, view: float) -> str:
    """Describe a fit and a view in words."""
    scene, (sensor,) = room.measured.scene, room.measured.sensors(room.views[:1], room.rows)
    renderer = FieldRenderer.make(scene, field, RenderSettings(adaptive=False))

    def sample(integrator: mi.Integrator) -> None:
        np.array(mi.render(scene, sensor=sensor, integrator=integrator, spp=SAMPLES))

    ours, theirs = (
        1e3 * time_of(partial(sample, each)) / SAMPLES
        for each in (renderer.integrator, mi.load_dict(UNLIMITED))
    )
    return (
        f"{field.record['passes']} passes in {field.record['seconds']:.0f} s, estimated "
        f"{field.record['estimated_psnr']:.1f} dB; {view:.2f} s per view; {ours:.0f} ms per "
        f"sample, path {theirs:.0f} ms, ratio {ours / theirs:.2f}"
    )

"""The field and other methods at the same total time, in any scene."""

from __future__ import annotations

import tempfile
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

from baselines.options import BaselineOptions, CyclesOptions, DenoisedOptions, LuxcoreOptions
from baselines.protocol import CannotServe, Task
from baselines.registry import make_baseline
from benchmarks import cli
from benchmarks.measured_scenes import MeasuredScene, open_scene
from benchmarks.pictures import side_by_side, stacked
from benchmarks.truth import (
    Truth,
    decibels,
    in_parts,
    keep,
    path_parts,
    radiance_pairs,
    sppm,
    sppm_images,
)
from gpf.field.field import GaussianPhotonField
from gpf.rendering.field_renderer import FieldRenderer
from gpf.rendering.settings import Gather, RenderSettings
from gpf.rendering.timed_sampling import time_of
from gpf.scene.media import Media
from gpf.scene.snapshot import snapshot_scene
from gpf.scene.views import View

UNLIMITED = {"type": "path", "max_depth": -1, "rr_depth": 5}

SAMPLES = 8
"""Samples per pixel that are rendered at once to time one."""


DENOISED = DenoisedOptions(system="denoised", spp="equal_time")

RENDERERS: dict[str, BaselineOptions] = {
    "Cycles": CyclesOptions(system="cycles", seconds="equal_time"),
    "LuxCore": LuxcoreOptions(system="luxcore", seconds="equal_time"),
}

KERNELS = 1000, 4000
"""First and last of the passes whose kernels SPPM has where it is the truth."""

DOUBTFUL = 0.03
"""Where SPPM's energy differs by more from that of `path`, two standard errors aside, there is
light that `path` does not find: a sun behind panes of glass, or on steel."""


@dataclass(frozen=True)
class Room:
    """A scene, the views that are rendered, which of them are judged, and their truth.

    Attributes
    ----------
    kept: a folder for what the methods leave.
    """

    measured: MeasuredScene
    file: Path
    views: Sequence[View]
    judged: Sequence[int]
    rows: int
    truth: Truth
    kept: Path


def rooms(
    scenes: Annotated[list[str], typer.Argument(help="Scene files, or scenes of `scenes/`.")],
    seconds: cli.Seconds = 60,
    passes: Annotated[
        int | None, typer.Option(help="Passes of the fit, however long they take.")
    ] = None,
    rows: cli.Rows = 256,
    views: Annotated[int, typer.Option(min=1, help="Number of views to render.")] = 10,
    judged: Annotated[int, typer.Option(min=1, help="Number of views to judge.")] = 3,
    samples: cli.Samples = 1024,
    renderers: Annotated[
        float | None,
        typer.Option(help="Also Cycles and LuxCore, at the same time and with so many s a view."),
    ] = None,
    gather: Annotated[Gather, typer.Option(help="As for `gpf render`.")] = "auto",
    kept: cli.Kept = Path("results/rooms"),
) -> None:
    """Field, `path` with a denoiser, and SPPM, with the same time for all views together.

    A field is fitted, and some views of it are rendered, the scene's own among them, denoised as by
    `gpf render`; then `path` with Open Image Denoise, and SPPM, each with as much time as the fit
    and the views took. A few views are judged against two independent images by `path`: PSNR over
    all their pixels, FLIP, and energy, the sum of the image divided by that of the truth, without
    the brightest half percent of the pixels of either. SPPM with a fifth as many passes is the
    judge in the scenes of `scenes/`, in those with media, and where its energy is another than that
    of `path`. Below the table: the fit, and the time of a sample, compared with `path` without a
    depth limit. `NAME.png` shows the judged views by all methods.
    """
    for scene in scenes:
        room = open_room(scene, rows, views, judged, samples, kept)
        settings = RenderSettings(denoise=True, gather=gather)
        compare(room, {"passes": passes} if passes else {"seconds": seconds}, settings, renderers)


def open_room(scene: str, rows: int, count: int, judged: int, samples: int, kept: Path) -> Room:
    """A scene with its own camera and others that are placed around it, or with the novel views of
    `scenes/` and frames of its path."""
    measured, file = open_scene(scene), Path(scene)
    first = [] if measured.views else [measured.own]
    if measured.views:
        file = kept / measured.name / "scene.xml"
        snapshot_scene(scene, file.parent)
    source = measured.views or measured.placed
    views = [*first, *source.novel, *source.frames()[3::6]][:count]
    chosen = np.linspace(0, len(views) - 1, judged).round().astype(int).tolist()
    sensors = measured.sensors([views[k] for k in chosen], rows)

    def by_photons(passes: int) -> np.ndarray:
        each = max(passes // 2, 1)
        images = sppm_images(scene, measured.scene, sensors, each, KERNELS, seeds=range(4))
        return in_parts(radiance_pairs(images))

    def parts() -> dict[str, np.ndarray]:
        passes = samples // 5
        if measured.views or Media(measured.scene).there:
            return {"parts": by_photons(passes)}
        found = path_parts(measured.name, measured.scene, sensors, samples)
        few, by_path = by_photons(passes // 5), Truth.of_parts(found, measured.exposure)
        energy = by_path.energy(few.mean(axis=(1, 2)))
        error = np.std([by_path.energy(few[:, j, k]) for j in (0, 1) for k in (0, 1)], ddof=1) / 2
        if abs(energy - 1) < DOUBTFUL + 2 * error:
            return {"parts": found}
        return {"parts": by_photons(passes), "doubt": np.array(energy)}

    file_name = f"{measured.name}_{rows}_{len(views)}_{judged}_{samples}_judge.npz"
    found = keep(kept / file_name, parts)
    if "doubt" in found:
        light = f"{float(found['doubt']):.3f} times the light of `path`"
        print(f"{measured.name}: SPPM has {light}, so SPPM is the judge.")
    truth = Truth.of_parts(found["parts"], measured.exposure)
    return Room(measured, file, views, chosen, rows, truth, kept)


def compare(
    room: Room, goal: dict[str, Any], settings: RenderSettings, renderers: float | None = None
) -> None:
    """Print the table of one room."""
    name, truth = room.measured.name, room.truth
    table = Table("method", "total s", "PSNR", "FLIP", "energy", title=name)
    found: dict[str, np.ndarray] = {}

    def add(method: str, seconds: float, images: np.ndarray | str) -> None:
        if isinstance(images, str):
            table.add_row(method, "-", images)
            return
        quality = decibels(truth.errors(images).mean()), f"{truth.flip(images):.3f}"
        table.add_row(method, f"{seconds:.0f}", *quality, f"{truth.energy(images):.3f}")
        found[f"{method}, {quality[0]} dB"] = truth.shown(images)

    start = time.perf_counter()
    own = room.measured.views
    field = room.measured.fit(own.train if own else None, **goal)
    fitted = time.perf_counter()
    images = room.measured.render(field, room.views, room.rows, settings)
    total = time.perf_counter() - start
    view = total / len(room.views)
    add("field", total, images[room.judged])
    add("path + OIDN", total, render_by(room, DENOISED, view))
    add("SPPM", total, render_photons(room, total))
    for method, options in RENDERERS.items():
        if renderers:
            add(method, total, render_by(room, options, view))
            longer = render_by(room, options, renderers)
            add(f"{method} {renderers:g} s", renderers * len(room.views), longer)
    found["truth"] = truth.shown(truth.halves.mean(axis=1))
    views = range(len(room.judged))
    strips = [side_by_side([i[k] for i in found.values()], [*found]) for k in views]
    stacked(strips).save(room.kept / f"{name}.png")
    console = Console(width=100)
    console.print(table)
    console.print(describe(room, field, (total - fitted + start) / len(room.views)))


def render_by(room: Room, options: BaselineOptions, seconds: float) -> np.ndarray | str:
    """The judged views by another system, in ``seconds`` seconds each; or why it cannot."""
    with tempfile.TemporaryDirectory(dir=room.kept) as state:
        task = Task(
            room.measured.name,
            room.measured.scene,
            room.file,
            room.measured.size(room.rows),
            room.truth.exposure,
            training=(),
            rr_depth=5,
            seed=0,
            state=Path(state),
            seconds_per_view=seconds,
        )
        try:
            prepared = make_baseline(options).prepare(task)
            return np.stack([prepared.render(room.views[k], seed=k) for k in room.judged])
        except CannotServe as refusal:
            return str(refusal)


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

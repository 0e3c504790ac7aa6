"""`python -m benchmarks.rooms FILE.xml …`: the field and other methods in published rooms.

For each scene file, a field is fitted, and some views of it are rendered, the scene's own among
them, denoised as by `gpf render`; then `path` with Open Image Denoise, and SPPM, each with as much
time for all views as the field took for the fit and the views together. A few of the views are
judged against the truth: two independent images by `path`, kept in a folder for the next run. The
output has

- the share of the photons that reach a diffuse surface seen by a camera, and the kernel's radius
  next to the distance of what the cameras look at;
- passes and estimated PSNR of the fit, and the seconds per view;
- the time of a sample, compared with `path` without a depth limit;
- for each method, the PSNR over all judged pixels, without the noise of the truth; FLIP; and the
  energy: the sum of the image divided by that of the truth, without the brightest half percent of
  the pixels of either.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
from PIL import Image
from rich.console import Console
from rich.table import Table

import gpf
from baselines.denoised.baseline import Denoised
from baselines.options import DenoisedOptions
from baselines.protocol import Task
from benchmarks.energy import TRIMMED, trace_paths
from gpf.camera.film import sample_film
from gpf.core.images import tone_map
from gpf.core.progress import progress_bar
from gpf.field.field import GaussianPhotonField
from gpf.guiding.emission_plan import EmissionPlan, VisibleRegionSettings
from gpf.importing.placement import place_views
from gpf.rendering.field_renderer import FieldRenderer
from gpf.rendering.settings import RenderSettings
from gpf.scene.load import load_scene_file
from gpf.scene.sensors import film_aspect, make_sensor, views_of_sensors
from gpf.scene.views import View
from gpf.sppm.reference import ReferenceRenderer, ReferenceSettings
from metrics.flip import evaluate_ldr

UNLIMITED = {"type": "path", "max_depth": -1, "rr_depth": 5}


@dataclass(frozen=True)
class Room:
    """A scene, the views that are rendered, and which of them are judged."""

    name: str
    file: Path
    scene: mi.Scene
    views: list[View]
    judged: list[int]
    size: tuple[int, int]
    exposure: float


@dataclass(frozen=True)
class Truth:
    """Two independent images of each judged view, (2, V, H, W, 3)."""

    halves: np.ndarray
    exposure: float

    def psnr(self, images: np.ndarray) -> float:
        """PSNR of images (V, H, W, 3), without the noise of the truth, dB."""
        a, b = (tone_map(half, self.exposure) for half in self.halves)
        shown = tone_map(images, self.exposure)
        return float(-10 * np.log10(max(((shown - a) * (shown - b)).mean(), 1e-9)))

    def flip(self, images: np.ndarray) -> float:
        """Mean LDR-FLIP."""
        shown, true = (
            tone_map(i, self.exposure).astype(np.float64) for i in (images, self.halves.mean(0))
        )
        return float(np.mean([evaluate_ldr(*pair) for pair in zip(shown, true, strict=True)]))

    def energy(self, images: np.ndarray) -> float:
        """Sum of images divided by that of the truth, without the brightest pixels of either."""
        true = self.halves.mean(axis=0)
        kept = np.ones(true.shape[:3], bool)
        for each in (images, true):
            light = each.mean(axis=3)
            kept &= light <= np.quantile(light, 1 - TRIMMED)
        return float(images[kept].sum() / true[kept].sum())


def main() -> None:
    """Print the tables of all rooms."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=60, help="seconds of the fit")
    parser.add_argument("--passes", type=int, help="passes of the fit, however long they take")
    parser.add_argument("--rows", type=int, default=256)
    parser.add_argument("--views", type=int, default=10, help="number of views to render")
    parser.add_argument("--judged", type=int, default=3, help="number of views to judge")
    parser.add_argument("--samples", type=int, default=1024, help="samples per pixel of the truth")
    parser.add_argument("--field-only", action="store_true")
    parser.add_argument("--kept", type=Path, default=Path("results/rooms"))
    parser.add_argument("files", type=Path, nargs="+")
    arguments = parser.parse_args()
    for file in arguments.files:
        room = open_room(file, arguments.rows, arguments.views, arguments.judged)
        truth = find_truth(room, arguments.samples, arguments.kept)
        compare(room, truth, arguments)


def open_room(file: Path, rows: int, count: int, judged: int) -> Room:
    """A scene with its own camera and others that are placed around it."""
    scene = load_scene_file(file)
    name = file.parent.name if file.stem == "scene" else file.stem
    own, aspect = views_of_sensors(scene)[:1], film_aspect(scene.sensors()[0])
    placed = place_views(scene, own, aspect)
    others = [*placed.novel, *placed.frames()[3::6]]
    views = [*own, *others][:count]
    chosen = np.linspace(0, len(views) - 1, judged).round().astype(int).tolist()
    return Room(name, file, scene, views, chosen, (round(rows * aspect), rows), placed.exposure)


def find_truth(room: Room, samples: int, kept: Path) -> Truth:
    """The truth, from the folder if it is there."""
    file = kept / f"{room.name}_{room.size[1]}_{len(room.judged)}_{samples}.npz"
    if not file.exists():
        kept.mkdir(parents=True, exist_ok=True)
        halves = [
            [
                trace_paths(
                    room.name, room.scene, make_sensor(room.views[k], *room.size), samples, seed, 32
                )
                for k in room.judged
            ]
            for seed in range(2)
        ]
        np.savez_compressed(file, halves=np.array(halves, np.float32))
    with np.load(file) as stored:
        return Truth(stored["halves"], room.exposure)


def compare(room: Room, truth: Truth, arguments: argparse.Namespace) -> None:
    """Print the table of one room, and write the judged pictures."""
    table = Table("method", "total s", "PSNR", "FLIP", "energy", title=room.name)

    def add(method: str, seconds: float, images: np.ndarray) -> None:
        cells = (
            f"{truth.psnr(images):.1f}",
            f"{truth.flip(images):.3f}",
            f"{truth.energy(images):.3f}",
        )
        table.add_row(method, f"{seconds:.0f}", *cells)
        write_pictures(arguments.kept / room.name / method, room, images)

    start = time.perf_counter()
    with progress_bar(f"{room.name}: fit", 1):
        seconds = None if arguments.passes else arguments.seconds
        field = gpf.fit(room.scene, seconds=seconds, passes=arguments.passes)
    fitted = time.perf_counter()
    images = render_field(room, field)
    total = time.perf_counter() - start
    add("field", total, images[room.judged])
    if not arguments.field_only:
        seconds = total / len(room.views)
        add("path + OIDN", total, render_denoised(room, seconds, arguments.kept))
        add("SPPM", total, render_photons(room, total))
    write_pictures(arguments.kept / room.name / "truth", room, truth.halves.mean(axis=0))
    console = Console(width=100)
    console.print(table)
    console.print(describe(room, field, (total - fitted + start) / len(room.views)))


def render_field(room: Room, field: GaussianPhotonField) -> np.ndarray:
    """All views from a field, (V, H, W, 3)."""
    renderer = FieldRenderer.make(room.scene, field, RenderSettings(denoise=True))
    with progress_bar(f"{room.name}: views", len(room.views)) as bar:
        images = []
        for k, view in enumerate(room.views):
            images.append(renderer.render(view, room.size, seed=k)["radiance"])
            bar(k + 1)
    return np.stack(images)


def render_denoised(room: Room, seconds: float, state: Path) -> np.ndarray:
    """The judged views by `path` and Open Image Denoise, in ``seconds`` seconds each."""
    task = Task(
        room.name,
        room.scene,
        room.file,
        room.size,
        room.exposure,
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
    sensors = {f"{k}": make_sensor(view, *room.size) for k, view in enumerate(room.views)}
    plan = EmissionPlan.make(room.scene, list(sensors.values()), VisibleRegionSettings())
    settings = ReferenceSettings().measure(room.scene, sensors["0"], plan)
    renderer = ReferenceRenderer(room.scene, sensors, {}, settings, 0, plan.source)
    sums, number, end = renderer.empty_sums(), 0, time.perf_counter() + seconds
    while time.perf_counter() < end:
        number += 1
        renderer.run_pass(number, sums)
    return np.stack([renderer.image(f"{k}", sums) for k in room.judged])


def describe(room: Room, field: GaussianPhotonField, view: float) -> str:
    """Describe a fit and a view in words."""
    sensor = make_sensor(room.views[0], *room.size)
    plan = EmissionPlan.make(room.scene, [sensor], VisibleRegionSettings())
    settings = ReferenceSettings().measure(room.scene, sensor, plan)
    record, arriving = field.record, plan.facts()["photons_in_region_per_path"]
    seen = sample_film(room.scene, sensor, 0).points
    distance = dr.norm(seen.p - sensor.world_transform().translation()).numpy()
    far = float(np.median(distance[seen.valid.numpy()]))
    renderer = FieldRenderer.make(room.scene, field, RenderSettings(adaptive=False))
    times = [
        time_sample(room.scene, sensor, integrator)
        for integrator in (renderer.integrator, mi.load_dict(UNLIMITED))
    ]
    return (
        f"{room.name}: {record['passes']} passes in {record['seconds']:.0f} s, estimated "
        f"{record['estimated_psnr']:.1f} dB, {field.gaussians.means.numpy().shape[1]} Gaussians; "
        f"{arriving:.3g} photons per path arrive; first kernel radius "
        f"{settings.initial_radius:.3g}, what the camera sees is {far:.3g} away; "
        f"{view:.2f} s per view; {1e3 * times[0]:.0f} ms per sample, path {1e3 * times[1]:.0f} ms, "
        f"ratio {times[0] / times[1]:.2f}"
    )


def time_sample(scene: mi.Scene, sensor: mi.Sensor, integrator: mi.Integrator) -> float:
    """Seconds for one sample per pixel, the least of several measurements."""
    found = []
    for seed in range(4):
        start = time.perf_counter()
        np.array(mi.render(scene, sensor=sensor, integrator=integrator, spp=8, seed=seed))
        found.append((time.perf_counter() - start) / 8)
    return min(found)


def write_pictures(folder: Path, room: Room, images: np.ndarray) -> None:
    """Write the judged views as PNG files."""
    folder.mkdir(parents=True, exist_ok=True)
    for k, image in zip(room.judged, images, strict=True):
        shown = np.round(255 * tone_map(image, room.exposure)).astype(np.uint8)
        Image.fromarray(shown).save(folder / f"{k}.png")


if __name__ == "__main__":
    from gpf.core.runtime import choose_variant

    choose_variant("auto")
    main()

"""`python -m benchmarks.fit [--seconds S | --times T | --passes N] [SCENE …]`: `gpf.fit` alone.

The scenes are those of `scenes/` and of `benchmarks/check_scenes.py`. The fit places its own
cameras; with `--views training` it gets the training views of the scene, with `--views judged` also
those that are judged. Judged are the novel views of `scenes/`, or frames of the path that `gpf
scene import` would place. `--times T`: T times as long as SPPM with 1000 passes takes for a view.

One line per scene, with the time of such a view, and the PSNR

- that the fit estimates, and that of the rendered field against SPPM with 1000 passes, at the
  exposure that the fit has chosen, and at that of the scene's views;
- of a second SPPM with 1000 passes against the first;
- of the field against the truth, in all pixels and by region (:mod:`benchmarks.regions`).

The truth is what two independent references A and B have in common: the mean of (f - A) (f - B) is
the squared error of the image f without the noise of the references. Their noise, from A - B, gives
the PSNR against a reference with 1000 passes. References are kept in a folder for the next run.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, replace
from pathlib import Path

import mitsuba as mi
import numpy as np
from rich.console import Console
from rich.table import Table

import gpf
from benchmarks.check_scenes import SCENES
from benchmarks.placement import open_scene
from benchmarks.regions import REGIONS, find_regions
from gpf.core.images import tone_map
from gpf.core.progress import progress_bar
from gpf.field.field import GaussianPhotonField
from gpf.guiding.emission_plan import EmissionPlan, VisibleRegionSettings
from gpf.importing.placement import place_views
from gpf.rendering.field_renderer import FieldRenderer
from gpf.rendering.settings import RenderSettings
from gpf.scene.folders import list_scenes, load_views
from gpf.scene.sensors import make_sensor
from gpf.scene.views import View
from gpf.sppm.reference import ReferenceRenderer, ReferenceSettings

ROWS = 256
STANDARD = 1000  # passes


@dataclass(frozen=True)
class Judged:
    """The judged views of a scene.

    Attributes
    ----------
    images: two independent references of each view, (V, 2, H, W, 3).
    regions: the number of each pixel's region, (V, H W).
    passes: of each reference.
    """

    views: list[View]
    size: tuple[int, int]
    exposure: float
    images: np.ndarray
    regions: np.ndarray
    passes: int

    def errors(self, images: np.ndarray) -> np.ndarray:
        """Squared error of images (V, H, W, 3) at each pixel, without noise, (V, H W)."""
        a, b = (tone_map(self.images[:, k], self.exposure) for k in range(2))
        f = tone_map(images, self.exposure)
        return ((f - a) * (f - b)).mean(axis=3).reshape(self.regions.shape)

    def noise(self, passes: int) -> float:
        """Mean squared error of an image by SPPM with so many passes."""
        a, b = (tone_map(self.images[:, k], self.exposure) for k in range(2))
        return float(((a - b) ** 2).mean() / 2 * self.passes / passes)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    goal = parser.add_mutually_exclusive_group()
    goal.add_argument("--seconds", type=float)
    goal.add_argument("--times", type=float)
    goal.add_argument("--passes", type=int)
    parser.add_argument("--views", choices=("training", "judged"))
    parser.add_argument("--reference-passes", type=int, default=200)
    parser.add_argument("--references", type=Path, default=Path("results/benchmark_references"))
    parser.add_argument("scenes", nargs="*", default=[*list_scenes(), *SCENES])
    arguments = parser.parse_args()
    arguments.references.mkdir(parents=True, exist_ok=True)
    columns = (
        "passes",
        "s",
        "SPPM s",
        "Gaussians",
        "estimated",
        "so exposed",
        "measured",
        "second SPPM",
        "truth",
    )
    table = Table("scene", *columns, *REGIONS)
    for name in arguments.scenes:
        table.add_row(name, *judge(name, arguments))
        Console(width=150).print(table)


def judge(name: str, arguments: argparse.Namespace) -> list[str]:
    """Fit a field to a scene, and compare its images with references; the cells of a line."""
    scene, own, aspect = open_scene(name)
    judged = references(name, scene, own, aspect, arguments)
    sensors = None
    if arguments.views:
        views = [own] if name in SCENES else list(load_views(name).train)
        views += judged.views if arguments.views == "judged" else []
        sensors = [make_sensor(view, *judged.size) for view in views]
    view = time_view(scene, make_sensor(own, *judged.size))
    seconds = arguments.times * view if arguments.times else arguments.seconds
    with progress_bar(f"{name}: fit", 1):
        field = gpf.fit(scene, sensors, seconds=seconds, passes=arguments.passes)
    images, record = render(scene, field, judged), field.record
    errors, noise = judged.errors(images), judged.noise(STANDARD)
    so_exposed = replace(judged, exposure=record["exposure"])
    cells = [
        str(record["passes"]),
        f"{record['seconds']:.0f}",
        f"{view:.0f}",
        str(len(field.gaussians.means.numpy().T)),
        f"{record['estimated_psnr']:.1f}",
        decibels(so_exposed.errors(images).mean() + so_exposed.noise(STANDARD)),
        decibels(errors.mean() + noise),
        decibels(2 * noise),
        decibels(errors.mean()),
    ]
    for number in range(len(REGIONS)):
        chosen = judged.regions == number
        cells.append(decibels(errors[chosen].mean()) if chosen.mean() > 1e-3 else "")
    return cells


def time_view(scene: mi.Scene, sensor: mi.Sensor, passes: int = 24) -> float:
    """Seconds that SPPM with :data:`STANDARD` passes takes for a view, from some of its passes."""
    plan = EmissionPlan.make(scene, [sensor], VisibleRegionSettings())
    settings = ReferenceSettings().measure(scene, sensor, plan)
    renderer = ReferenceRenderer(scene, {"own": sensor}, {}, settings, 0, plan.source)
    sums = renderer.empty_sums()
    spent = []
    for k in range(passes):
        start = time.perf_counter()
        renderer.run_pass(1 + k * STANDARD // passes, sums)
        spent.append(time.perf_counter() - start)
    return STANDARD * float(np.median(spent[2:]))  # the first ones compile


def decibels(error: float) -> str:
    """The PSNR for a mean squared error, as text."""
    return f"{-10 * np.log10(error):.1f}" if error > 0 else "-"


def render(scene: mi.Scene, field: GaussianPhotonField, judged: Judged) -> np.ndarray:
    """The judged views from a field, (V, H, W, 3)."""
    renderer = FieldRenderer.make(scene, field, RenderSettings())
    views = enumerate(judged.views)
    return np.stack([renderer.render(v, judged.size, seed=k)["radiance"] for k, v in views])


def references(
    name: str, scene: mi.Scene, own: View, aspect: float, arguments: argparse.Namespace
) -> Judged:
    """The judged views with two references each, from the folder of references if it has them."""
    if name in SCENES:
        placed = place_views(scene, [own], aspect)
        views, exposure = placed.frames()[3::6], placed.exposure
    else:
        views, exposure = load_views(name).novel, load_views(name).exposure
    size = round(ROWS * aspect), ROWS
    passes = arguments.reference_passes
    file = arguments.references / f"{name}_{ROWS}_{passes}.npz"
    if not file.exists():
        images, regions = trace(name, scene, [make_sensor(v, *size) for v in views], passes)
        np.savez_compressed(file, images=images, regions=regions)
    with np.load(file) as kept:
        return Judged(views, size, exposure, kept["images"], kept["regions"], passes)


def trace(
    name: str, scene: mi.Scene, sensors: list[mi.Sensor], passes: int
) -> tuple[np.ndarray, np.ndarray]:
    """Two references of each view, (V, 2, H, W, 3), and the regions of its pixels, (V, H W)."""
    plan = EmissionPlan.make(scene, sensors, VisibleRegionSettings())
    settings = ReferenceSettings().measure(scene, sensors[0], plan)
    named = {f"{k}": sensor for k, sensor in enumerate(sensors)}
    images: list[list[np.ndarray]] = [[] for _ in sensors]
    layers = []
    for seed in range(2):
        renderer = ReferenceRenderer(scene, named, {}, settings, seed, plan.source)
        sums = renderer.empty_sums()
        with progress_bar(f"{name}: reference {seed + 1}", passes) as bar:
            for k in range(passes):
                # The radii of all passes of a reference.
                renderer.run_pass(1 + k * STANDARD // passes, sums)
                bar(k + 1)
        for k, view in enumerate(named):
            images[k].append(renderer.image(view, sums))
        layers.append([renderer.view(view, sums).layers() for view in named])
    both = np.asarray(images)
    regions = []
    for k, sensor in enumerate(sensors):
        mean = layers[0][k] | {"radiance": both[k].mean(axis=0)}
        regions.append(find_regions(scene, sensor, mean))
    return both, np.stack(regions)


if __name__ == "__main__":
    from gpf.core.runtime import choose_variant

    choose_variant("auto")
    main()

"""SPPM images with which the benchmarks compare the field's.

The truth is what two independent SPPM images A and B have in common. Their kernels are half as wide
as those of the last pass of an ordinary reference. The mean of (f - A) (f - B) is the squared error
of the image f without the noise of A and B. Ordinary references have wider kernels, in all of their
passes, and show caustics softer than they are. Two of them, a and b, are compared with the truth
too: their error is the mean of (a - A) (b - B), plus their noise, from a - b. All images are kept
in a folder for the next run.

With the truth `long`, A and B have the kernels of references with 4000 passes.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import mitsuba as mi
import numpy as np

import gpf
from benchmarks.check_scenes import SCENES
from benchmarks.placement import open_scene
from benchmarks.regions import find_regions
from gpf.core.images import tone_map
from gpf.core.progress import progress_bar
from gpf.field.field import GaussianPhotonField
from gpf.field.io import load_field, save_field
from gpf.guiding.emission_plan import EmissionPlan, VisibleRegionSettings
from gpf.importing.placement import place_views
from gpf.rendering.field_renderer import FieldRenderer
from gpf.rendering.settings import RenderSettings
from gpf.scene.folders import list_scenes, load_views
from gpf.scene.sensors import make_sensor
from gpf.scene.views import View
from gpf.sppm.reference import ReferenceRenderer, ReferenceSettings

STANDARD = 1000
"""Passes of an ordinary reference."""

KERNELS = {"": (1, 1000), "sharp": (64_000, 65_000), "long": (1, 4000)}
"""First and last of the passes whose kernels each kind of image uses."""

FIT_ROWS = 256
"""Rows of the views to which fields are fitted."""


@dataclass(frozen=True)
class Kept:
    """Where references are kept, and how many passes each has."""

    folder: Path
    passes: int


@dataclass(frozen=True)
class Judged:
    """The judged views of a scene.

    Attributes
    ----------
    images: two independent ordinary references of each view, (V, 2, H, W, 3).
    truth: two independent images of the truth, (V, 2, H, W, 3).
    regions: the number of each pixel's region, (V, H W).
    passes: passes of each image.
    """

    views: list[View]
    size: tuple[int, int]
    exposure: float
    images: np.ndarray
    truth: np.ndarray
    regions: np.ndarray
    passes: int

    def errors(self, images: np.ndarray, again: np.ndarray | None = None) -> np.ndarray:
        """Squared error of images (V, H, W, 3) at each pixel, against the truth, (V, H W).

        ``again``: the same images with other samples, so that their noise does not count.
        """
        a, b = self._shown(self.truth)
        f = tone_map(images, self.exposure)
        g = f if again is None else tone_map(again, self.exposure)
        return ((f - a) * (g - b)).mean(axis=3).reshape(self.regions.shape)

    def reference_errors(self, passes: int = STANDARD) -> np.ndarray:
        """The same for an ordinary reference with ``passes`` passes, its noise included."""
        a, b = self._shown(self.images)
        true_a, true_b = self._shown(self.truth)
        blur = ((a - true_a) * (b - true_b)).mean(axis=3).reshape(self.regions.shape)
        return blur + self.noise(passes)

    def differences(self, images: np.ndarray) -> np.ndarray:
        """Squared difference of images (V, H, W, 3) from an ordinary reference, its noise included,
        (V, H W)."""
        a, b = self._shown(self.images)
        f = tone_map(images, self.exposure)
        return ((f - a) * (f - b)).mean(axis=3).reshape(self.regions.shape) + self.noise(STANDARD)

    def noise(self, passes: int) -> np.ndarray:
        """Squared noise of an ordinary reference with ``passes`` passes, (V, H W)."""
        a, b = self._shown(self.images)
        noise: np.ndarray = ((a - b) ** 2).mean(axis=3) / 2 * self.passes / passes
        return noise.reshape(self.regions.shape)

    def _shown(self, images: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return tone_map(images[:, 0], self.exposure), tone_map(images[:, 1], self.exposure)


def kept_field(
    name: str, scene: mi.Scene, own: View, aspect: float, seconds: float, kept: Kept
) -> GaussianPhotonField:
    """A field fitted for ``seconds`` with the scene's training views, or the one in the folder."""
    file = kept.folder / f"{name}_{seconds:g}s.safetensors"
    if not file.exists():
        views = training_views(name, own)
        sensors = [make_sensor(view, round(FIT_ROWS * aspect), FIT_ROWS) for view in views]
        with progress_bar(f"{name}: fit", 1):
            save_field(gpf.fit(scene, sensors, seconds=seconds), file)
    return load_field(file)


def decibels(error: float) -> str:
    """The PSNR for a mean squared error, as text."""
    return f"{-10 * np.log10(error):.1f}" if error > 0 else "-"


def mean_psnr(errors: np.ndarray) -> str:
    """The mean of the views' PSNR, as text, from squared errors (V, H W)."""
    each = errors.mean(axis=1)
    return f"{-10 * np.log10(each).mean():.1f}" if each.min() > 0 else "-"


def render(
    scene: mi.Scene,
    field: GaussianPhotonField,
    judged: Judged,
    settings: RenderSettings = RenderSettings(),
) -> np.ndarray:
    """The judged views from a field, (V, H, W, 3)."""
    renderer = FieldRenderer.make(scene, field, settings)
    views = enumerate(judged.views)
    return np.stack([renderer.render(v, judged.size, seed=k)["radiance"] for k, v in views])


def references(
    name: str,
    scene: mi.Scene,
    views: list[View],
    size: tuple[int, int],
    exposure: float,
    kept: Kept,
    truth: str = "sharp",
) -> Judged:
    """Views with two references each, from the folder of references if it has them; ``truth``: one
    of :data:`KERNELS`."""
    found = {}
    for kind in ("", truth):
        title = f"{name}_{kind}" if kind else name
        file = kept.folder / f"{title}_{size[1]}_{len(views)}_{kept.passes}.npz"
        if not file.exists():
            kept.folder.mkdir(parents=True, exist_ok=True)
            sensors = [make_sensor(view, *size) for view in views]
            images, regions = trace(name, scene, sensors, kept.passes, KERNELS[kind])
            np.savez_compressed(file, images=images, regions=regions)
        with np.load(file) as stored:
            found[kind] = stored["images"], stored["regions"]
    (images, regions), (true, _) = found[""], found[truth]
    return Judged(views, size, exposure, images, true, regions, kept.passes)


def open_field(
    name: str, rows: int, count: int | None, arguments: argparse.Namespace, truth: str = "sharp"
) -> tuple[mi.Scene, GaussianPhotonField, Judged]:
    """A scene with a field for :func:`options`, and the first ``count`` of its judged views."""
    scene, own, aspect = open_scene(name)
    views, exposure = judged_views(name, scene, own, aspect)
    kept = Kept(arguments.kept, arguments.reference_passes)
    size = round(rows * aspect), rows
    judged = references(name, scene, views[:count], size, exposure, kept, truth)
    return scene, kept_field(name, scene, own, aspect, arguments.seconds, kept), judged


def options(description: str, passes: int) -> argparse.ArgumentParser:
    """The options of a benchmark whose fields are fitted for some seconds and kept."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--seconds", type=float, default=120)
    parser.add_argument("--reference-passes", type=int, default=passes)
    parser.add_argument("--kept", type=Path, default=Path("results/benchmark_references"))
    parser.add_argument("scenes", nargs="*", default=list_scenes())
    return parser


def training_views(name: str, own: View) -> list[View]:
    """The training views of `scenes/`; for another scene, its own camera."""
    return [own] if name in SCENES else list(load_views(name).train)


def judged_views(name: str, scene: mi.Scene, own: View, aspect: float) -> tuple[list[View], float]:
    """The novel views of ``scenes/``, or frames of the path that `gpf scene import` would place;
    and the exposure."""
    if name in SCENES:
        placed = place_views(scene, [own], aspect)
        return placed.frames()[3::6], placed.exposure
    views = load_views(name)
    return list(views.novel), views.exposure


def trace(
    name: str,
    scene: mi.Scene,
    sensors: list[mi.Sensor],
    passes: int,
    kernels: tuple[int, int],
) -> tuple[np.ndarray, np.ndarray]:
    """Two images of each view, (V, 2, H, W, 3), and the regions of its pixels, (V, H W).

    Parameters
    ----------
    kernels: the images have the kernels of passes between these two, spread evenly.
    """
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
                first, last = kernels
                renderer.run_pass(first + k * (last + 1 - first) // passes, sums)
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

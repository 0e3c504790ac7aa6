"""`python -m benchmarks.energy [SCENE …]`: is a field as bright as the truth?

For each scene and each length of the fit, the mean of the field's image divided by that of the
truth: on open surfaces, and in the whole picture without the brightest half percent of the pixels
of either. The truth is Mitsuba's `path`; in the scenes of `scenes/`, where it does not find all
light, SPPM with photons of its own. The table also has the same ratio for SPPM with few passes,
which learns nothing, and the standard error of the truth's mean on open surfaces.

A pixel is open if its rays hit a single diffuse surface directly, away from steps in the light and,
in the scenes under a sky, away from the block of glass.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import dataclass
from pathlib import Path

import mitsuba as mi
import numpy as np
from rich.console import Console
from rich.table import Table

import gpf
from benchmarks.lit_scenes import GLASS_AT, NAMES, load
from benchmarks.placement import open_scene
from benchmarks.regions import REGIONS, find_regions
from gpf.core.progress import progress_bar
from gpf.guiding.emission_plan import EmissionPlan, VisibleRegionSettings
from gpf.rendering.field_renderer import FieldRenderer
from gpf.rendering.settings import RenderSettings
from gpf.scene.folders import list_scenes
from gpf.scene.sensors import film_aspect, make_sensor, views_of_sensors
from gpf.scene.views import View
from gpf.sppm.reference import ReferenceRenderer, ReferenceSettings

TRIMMED = 0.005
"""Fraction of the pixels, the brightest, left out when comparing the whole picture."""

NEAR_GLASS = 1.6
"""Distance from the block of glass, metres, within which its light may fall."""


@dataclass(frozen=True)
class Truth:
    """Two independent images, (2, H, W, 3), SPPM with few passes, (H, W, 3), and which pixels are
    open, (H, W)."""

    halves: np.ndarray
    sppm: np.ndarray
    is_open: np.ndarray

    def open_ratio(self, image: np.ndarray) -> float:
        """Mean of an image divided by that of the truth, on open surfaces."""
        return float(image[self.is_open].mean() / self.halves[:, self.is_open].mean())

    def whole_ratio(self, image: np.ndarray) -> float:
        """The same in the whole picture, without the brightest pixels of either."""
        truth = self.halves.mean(axis=0)
        light, other = image.mean(axis=2), truth.mean(axis=2)
        kept = light <= np.quantile(light, 1 - TRIMMED)
        kept &= other <= np.quantile(other, 1 - TRIMMED)
        return float(image[kept].mean() / truth[kept].mean())

    def uncertainty(self) -> float:
        """Relative standard error of the truth's mean on open surfaces."""
        a, b = (half[self.is_open].mean() for half in self.halves)
        pixels = np.abs(self.halves[0] - self.halves[1])[self.is_open].mean(axis=1)
        return float(np.sqrt((pixels**2).sum()) / len(pixels) / (a + b))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, nargs="*", default=[20, 60])
    parser.add_argument(
        "--passes", type=int, nargs="*", default=[], help="passes of the fits, instead of seconds"
    )
    parser.add_argument("--rows", type=int, default=128)
    parser.add_argument("--samples", type=int, default=4096, help="samples per pixel of the truth")
    parser.add_argument("--kept", type=Path, default=Path("results/benchmark_references"))
    parser.add_argument("scenes", nargs="*", default=[*NAMES, *list_scenes()])
    arguments = parser.parse_args()
    goals = [{"passes": n} for n in arguments.passes] or [{"seconds": s} for s in arguments.seconds]
    titles = [f"{value:g} {unit}" for goal in goals for unit, value in goal.items()]
    columns = [f"{title}, {part}" for title in titles for part in ("open", "whole")]
    table = Table("scene", "± truth", "SPPM, open", "SPPM, whole", *columns)
    for name in arguments.scenes:
        scene, own, aspect = open_any_scene(name)
        size = round(arguments.rows * aspect), arguments.rows
        truth = find_truth(name, scene, own, size, arguments.kept, arguments.samples)
        cells = [f"{truth.uncertainty():.4f}"]
        images = [truth.sppm, *(fit_and_render(name, scene, own, size, goal) for goal in goals)]
        for image in images:
            cells += [f"{truth.open_ratio(image):.3f}", f"{truth.whole_ratio(image):.3f}"]
        table.add_row(name, *cells)
        Console(width=60 + 20 * len(goals)).print(table)


def energy_row(rows: int, samples: int, passes: int) -> tuple[str, str, str, str, str]:
    """What is measured, mean of the field on open surfaces, that of the truth, ratio, and goal."""
    name = next(iter(NAMES))
    scene, own, aspect = open_any_scene(name)
    size = round(rows * aspect), rows
    with tempfile.TemporaryDirectory() as folder:
        truth = find_truth(name, scene, own, size, Path(folder), samples, passes)
    field = fit_and_render(name, scene, own, size, {"passes": passes})
    bright, expected = (
        float(image[..., truth.is_open, :].mean()) for image in (field, truth.halves)
    )
    return (
        f"light on an open plane under sun and sky after {passes} passes, vs path",
        f"{bright:.4f}",
        f"{expected:.4f}",
        f"{truth.open_ratio(field):.3f}",
        "1 ±.01",
    )


def open_any_scene(name: str) -> tuple[mi.Scene, View, float]:
    """A scene by name, its own camera, and width over height of its images."""
    if name not in NAMES:
        return open_scene(name)
    scene = load(name)
    return scene, views_of_sensors(scene)[0], film_aspect(scene.sensors()[0])


def fit_and_render(
    name: str, scene: mi.Scene, own: View, size: tuple[int, int], goal: dict[str, float]
) -> np.ndarray:
    """The picture of the scene's own camera from a field with cameras placed around it."""
    sensors = None if name in NAMES else [make_sensor(own, *size)]
    with progress_bar(f"{name}: fit", 1):
        field = gpf.fit(scene, sensors, **goal)  # type: ignore[arg-type]
    renderer = FieldRenderer.make(scene, field, RenderSettings())
    return renderer.render(own, size, seed=1)["radiance"]


def find_truth(
    name: str,
    scene: mi.Scene,
    own: View,
    size: tuple[int, int],
    kept: Path,
    samples: int = 4096,
    passes: int = 60,
) -> Truth:
    """The truth, from the folder of references if it is there.

    Parameters
    ----------
    samples: samples per pixel of `path` in each of two images; SPPM takes a fifth as many passes.
    passes: passes of the SPPM image that is compared with the truth.
    """
    file = kept / f"energy_{name}_{size[1]}_{samples}_{passes}.npz"
    if not file.exists():
        kept.mkdir(parents=True, exist_ok=True)
        sensor = make_sensor(own, *size)
        sppm, layers = trace_photons(name, scene, sensor, passes, seed=7)
        if name in NAMES:
            halves = [trace_paths(name, scene, sensor, samples, seed) for seed in range(2)]
        else:
            halves = [
                trace_photons(name, scene, sensor, samples // 5, seed)[0] for seed in range(2)
            ]
        # Steps in the light are looked for where there is little noise.
        regions = find_regions(scene, sensor, layers | {"radiance": np.mean(halves, axis=0)})
        is_open = (regions == REGIONS.index("rest")).reshape(size[::-1])
        is_open &= layers["valid"] > 0.5
        if name in GLASS_AT:
            far = np.linalg.norm(layers["position"] - GLASS_AT[name], axis=2) > NEAR_GLASS
            is_open &= far & (layers["normal"][..., 1] > 0.9)
        np.savez_compressed(file, halves=np.stack(halves), sppm=sppm, is_open=is_open)
    with np.load(file) as stored:
        return Truth(**stored)


def trace_paths(
    name: str, scene: mi.Scene, sensor: mi.Sensor, samples: int, seed: int, at_once: int = 128
) -> np.ndarray:
    """The radiance by `path`, (H, W, 3)."""
    integrator = mi.load_dict({"type": "path", "max_depth": -1, "rr_depth": 8})
    rounds = -(-samples // at_once)
    total: np.ndarray | float = 0.0
    with progress_bar(f"{name}: path", rounds) as bar:
        for k in range(rounds):
            own = seed * rounds + k
            image = mi.render(scene, sensor=sensor, integrator=integrator, spp=at_once, seed=own)
            total = total + np.array(image, dtype=np.float64)[..., :3]
            bar(k + 1)
    return np.asarray(total / rounds)


def trace_photons(
    name: str, scene: mi.Scene, sensor: mi.Sensor, passes: int, seed: int
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """The radiance by SPPM, (H, W, 3), and the layers of the view."""
    plan = EmissionPlan.make(scene, [sensor], VisibleRegionSettings(seed=seed))
    settings = ReferenceSettings(seed=seed).measure(scene, sensor, plan)
    renderer = ReferenceRenderer(scene, {"own": sensor}, {}, settings, seed, plan.source)
    with progress_bar(f"{name}: SPPM", passes) as bar:
        sums = renderer.run(passes, tick=bar)
    return renderer.image("own", sums), renderer.view("own", sums).layers()


if __name__ == "__main__":
    from gpf.core.runtime import choose_variant

    choose_variant("auto")
    main()

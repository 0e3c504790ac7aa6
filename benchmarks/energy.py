"""Whether a field is as bright as the truth."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks import cli, lit_scenes
from benchmarks.measured_scenes import MeasuredScene, open_scene
from benchmarks.regions import REGIONS, find_regions
from benchmarks.timing import Row
from benchmarks.truth import Truth, keep, path_parts, radiance_pairs, sppm_images
from gpf.scene.folders import list_scenes

NEAR_GLASS = 1.6
"""Distance from the block of glass, metres, within which its light may fall."""


def energy(
    scenes: cli.Scenes = None,
    seconds: cli.EachSeconds = None,
    passes: cli.EachPasses = None,
    rows: cli.Rows = 128,
    samples: cli.Samples = 4096,
    kept: cli.Kept = cli.KEPT,
) -> None:
    """The mean of a field's image divided by that of the truth, for each length of the fit.

    On open surfaces, and in the whole picture without the brightest half percent of the pixels of
    either. The truth is Mitsuba's `path`; in the scenes of `scenes/`, where it does not find all
    light, SPPM with a fifth as many passes and photons of its own. The table also has the same
    ratio for SPPM with few passes, which learns nothing, and the standard error of the truth's
    mean on open surfaces.

    A pixel is open if its rays hit a single diffuse surface directly, away from steps in the light
    and, on a plane under a sky, away from the block of glass.
    """
    asked = cli.goals(seconds, passes) or cli.goals((20, 60), ())
    titles = [f"{value:g} {unit}" for goal in asked for unit, value in goal.items()]
    columns = [f"{title}, {part}" for title in titles for part in ("open", "whole")]
    table = Table("scene", "± truth", "SPPM, open", "SPPM, whole", *columns)
    for name in scenes or [*lit_scenes.SCENES, *list_scenes()]:
        measured = open_scene(name)
        truth, sppm, is_open = find_truth(measured, rows, samples, kept)
        cells = [f"{uncertainty(truth, is_open):.4f}"]
        for image in (sppm, *(fit_and_render(measured, rows, goal) for goal in asked)):
            cells += [f"{truth.energy(image[None], chosen):.3f}" for chosen in (is_open, True)]
        table.add_row(name, *cells)
        Console(width=80 + 25 * len(asked)).print(table)


def energy_row(rows: int, samples: int, passes: int) -> Row:
    """The mean of a field on open surfaces, compared with that of the truth."""
    measured = open_scene("plane_under_sunsky")
    with tempfile.TemporaryDirectory() as folder:
        truth, _, is_open = find_truth(measured, rows, samples, Path(folder), passes)
    image = fit_and_render(measured, rows, {"passes": passes})
    return Row(
        f"light on an open plane under sun and sky after {passes} passes, vs path",
        f"{image[is_open].mean():.4f}",
        f"{truth.halves[0][:, is_open].mean():.4f}",
        f"{truth.energy(image[None], is_open):.3f}",
        "1 ±.01",
    )


def fit_and_render(measured: MeasuredScene, rows: int, goal: dict[str, Any]) -> np.ndarray:
    """The picture of the scene's own camera from a field with cameras placed around it."""
    field = measured.fit([measured.own] if measured.views else None, rows, **goal)
    return measured.render(field, [measured.own], rows)[0]


def find_truth(
    measured: MeasuredScene, rows: int, samples: int, kept: Path, passes: int = 60
) -> tuple[Truth, np.ndarray, np.ndarray]:
    """The truth of the scene's own view; SPPM with few passes, (H, W, 3); and which pixels are
    open, (H, W)."""
    name, scene, sensors = measured.name, measured.scene, measured.sensors([measured.own], rows)

    def make() -> dict[str, np.ndarray]:
        ((layers,),) = sppm_images(name, scene, sensors, passes, seeds=[7])
        if measured.views:
            (halves,) = radiance_pairs(sppm_images(name, scene, sensors, samples // 5))
        else:
            halves = path_parts(name, scene, sensors, samples)[0].mean(axis=1)
        # Steps in the light are looked for where there is little noise.
        regions = find_regions(scene, sensors[0], layers | {"radiance": halves.mean(axis=0)})
        is_open = (regions == REGIONS.index("rest")).reshape(layers["valid"].shape)
        is_open &= layers["valid"] > 0.5
        if name.startswith("plane"):
            away = np.linalg.norm(layers["position"] - lit_scenes.GLASS_AT, axis=2) > NEAR_GLASS
            is_open &= away & (layers["normal"][..., 1] > 0.9)
        return {"halves": halves, "sppm": layers["radiance"], "is_open": is_open}

    found = keep(kept / f"energy_{name}_{rows}_{samples}_{passes}.npz", make)
    return Truth(found["halves"][None], exposure=1), found["sppm"], found["is_open"]


def uncertainty(truth: Truth, chosen: np.ndarray) -> float:
    """Relative standard error of the truth's mean over chosen pixels."""
    a, b = truth.halves[0][:, chosen]
    pixels = np.abs(a - b).mean(axis=1)
    return float(np.sqrt((pixels**2).sum()) / len(pixels) / (a.mean() + b.mean()))

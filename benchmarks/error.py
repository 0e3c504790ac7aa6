"""Whether a field is as wrong as it says."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks import cli
from benchmarks.judged import Judged, judge_views, kept_field
from benchmarks.measured_scenes import open_scene
from benchmarks.truth import decibels
from gpf.rendering.aovs import expected_psnr
from gpf.rendering.field_renderer import FieldRenderer
from gpf.rendering.settings import RenderSettings
from gpf.scene.folders import list_scenes

SPP = 144
LEVELS = (0.01, 0.02, 0.04, 0.08)
LEAST_SHARE = 0.005  # of all pixels
EDGES = 0.03


def error(
    scenes: cli.Scenes = None,
    seconds: cli.Seconds = 120,
    rows: cli.Rows = 256,
    reference_passes: cli.ReferencePasses = 200,
    kept: cli.Kept = cli.KEPT,
) -> None:
    """Measured divided by predicted error, for pixels whose predicted error is about 1, 2, 4, 8 %.

    A field is fitted with the scene's training views. The novel views are rendered with many
    samples per pixel and the AOV `error`. In the table are root mean squares of relative errors,
    measured against references with 4000 passes. Neither their noise nor that of the camera samples
    counts, because two images of each view are compared with two references. The 3 % of the pixels
    at either end, mostly edges, are left out. The last column has the PSNR of all views together,
    predicted and measured.
    """
    table = Table("scene", *(f"{level:.0%}" for level in LEVELS), "all views")
    table.title = "measured / predicted error (share of the pixels); predicted, measured dB"
    for name in scenes or list_scenes():
        measured = open_scene(name)
        judged = judge_views(measured, rows, reference_passes, kept, kernels="long")
        field = kept_field(measured, seconds, kept)
        renderer = FieldRenderer.make(measured.scene, field, RenderSettings(spp=SPP), ["error"])
        table.add_row(name, *compare(renderer, judged, measured.size(rows)))
        Console(width=140).print(table)


def compare(renderer: FieldRenderer, judged: Judged, size: tuple[int, int]) -> list[str]:
    """The cells of a line."""
    images, errors = [], []
    for half in range(2):
        layers = [renderer.render(v, size, 2 * k + half) for k, v in enumerate(judged.views)]
        images.append(np.stack([each["radiance"] for each in layers]))
        errors.append(np.stack([each["error"] for each in layers]))
    radiance, predicted_error = np.mean(images, axis=0), np.mean(errors, axis=0)
    cells = [_ratio(judged.truth.halves, images, predicted_error, level) for level in LEVELS]
    measured = judged.truth.errors(*images).mean()
    pairs = zip(radiance, predicted_error, strict=True)
    expected = [expected_psnr(*view, judged.truth.exposure) for view in pairs]
    predicted = np.mean(10 ** (-0.1 * np.array(expected)))
    return [*cells, f"{decibels(float(predicted))}, {decibels(measured)}"]


def _ratio(
    halves: np.ndarray, images: Sequence[np.ndarray], errors: np.ndarray, level: float
) -> str:
    """Measured divided by predicted error, for pixels whose predicted error is about ``level``."""
    a, b = halves[:, 0], halves[:, 1]
    light = (a + b).mean(axis=-1) / 2
    chosen = (errors > level / 2**0.5) & (errors < level * 2**0.5) & (light > 0)
    if chosen.mean() < LEAST_SHARE:
        return "-"
    product = ((images[0] - a) * (images[1] - b)).mean(axis=-1)
    square = np.sort(product[chosen] / light[chosen] ** 2)
    cut = round(EDGES * len(square))
    measured = np.sqrt(max(float(square[cut : len(square) - cut].mean()), 0))
    predicted = np.sqrt(np.mean(errors[chosen] ** 2))
    return f"{measured / predicted:.2f} ({chosen.mean():.0%})"

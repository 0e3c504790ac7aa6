"""`python -m benchmarks.error [--seconds S] [SCENE …]`: is the field as wrong as it says?

A field is fitted for S seconds with the scene's training views. The novel views are rendered with
many samples per pixel and the AOV `error`. Pixels are sorted by the error that they predict; for
those around 1, 2, 4 and 8 %, the table has the root mean square of their measured relative error
divided by that of the predicted one; 1 would be perfect. Errors are measured against references
with 4000 passes, or against a sharper truth (:mod:`benchmarks.judged`). Neither their noise nor
that of the camera samples counts, because two images of each view are compared with two references.
The 3 % of the pixels at either end, mostly edges, are left out. The last columns have the PSNR,
predicted and measured: over all views, and in the view where the prediction is worst.
"""

from __future__ import annotations

import argparse

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.judged import Judged, decibels, open_field, options
from gpf.rendering.aovs import expected_psnr
from gpf.rendering.field_renderer import FieldRenderer
from gpf.rendering.settings import RenderSettings

ROWS, SPP = 256, 144
LEVELS = (0.01, 0.02, 0.04, 0.08)
LEAST_SHARE = 0.005  # of all pixels
EDGES = 0.03


def main() -> None:
    """Print the table."""
    parser = options(__doc__.splitlines()[0], passes=200)
    parser.add_argument("--truth", choices=("long", "sharp"), default="long")
    arguments = parser.parse_args()
    table = Table("scene", *(f"{level:.0%}" for level in LEVELS), "all views", "worst view")
    table.title = "measured / predicted error (share of the pixels); predicted, measured dB"
    for name in arguments.scenes:
        table.add_row(name, *judge(name, arguments))
        Console(width=140).print(table)


def judge(name: str, arguments: argparse.Namespace) -> list[str]:
    """The cells of a line."""
    scene, field, judged = open_field(name, ROWS, None, arguments, arguments.truth)
    renderer = FieldRenderer.make(scene, field, RenderSettings(spp=SPP), ["error"])
    images, errors = [], []
    for half in range(2):
        layers = [renderer.render(v, judged.size, 2 * k + half) for k, v in enumerate(judged.views)]
        images.append(np.stack([each["radiance"] for each in layers]))
        errors.append(np.stack([each["error"] for each in layers]))
    radiance, error = sum(images) / 2, sum(errors) / 2
    cells = [_ratio(judged, images, error, level) for level in LEVELS]
    measured = judged.errors(*images).mean(axis=1)
    expected = [expected_psnr(*view, judged.exposure) for view in zip(radiance, error, strict=True)]
    predicted = 10 ** (-0.1 * np.array(expected))
    worst = int(np.argmax(np.abs(np.log(predicted / np.maximum(measured, 1e-9)))))
    cells.append(f"{decibels(predicted.mean())}, {decibels(measured.mean())}")
    cells.append(f"{decibels(predicted[worst])}, {decibels(measured[worst])}")
    return cells


def _ratio(judged: Judged, images: list[np.ndarray], errors: np.ndarray, level: float) -> str:
    """Measured divided by predicted error, for pixels whose predicted error is about ``level``."""
    a, b = judged.truth[:, 0], judged.truth[:, 1]
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


if __name__ == "__main__":
    from gpf.core.runtime import choose_variant

    choose_variant("auto")
    main()

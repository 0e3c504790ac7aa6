"""Images of methods and their error maps, for figures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import PowerNorm
from matplotlib.patches import Rectangle

from gpf.core.images import read_exr, tone_map
from report.figures.sketch import Missing
from report.figures.style import system_of
from report.results import FIELD, SECOND_REFERENCE, Results, SceneResults

ERROR_MAP, LARGEST_ERROR = "magma", 0.25
"""Errors are differences of sRGB values. The colours also get brighter when printed in grey."""

ERRORS = ScalarMappable(PowerNorm(0.5, 0, LARGEST_ERROR, clip=True), ERROR_MAP)


@dataclass(frozen=True)
class Picture:
    """A method's image of a view.

    Attributes
    ----------
    title: the method's title.
    shown: displayed sRGB values in [0, 1], (H, W, 3).
    psnr: PSNR in the view, dB; None if not measured.
    """

    method: str
    title: str
    shown: np.ndarray
    psnr: float | None = None

    def error(self, reference: Picture) -> np.ndarray:
        """Mean absolute difference over the channels, (H, W)."""
        return np.asarray(np.abs(self.shown - reference.shown).mean(axis=-1))


def measured_views(scene: SceneResults, method: str) -> dict[str, float]:
    """View -> PSNR in dB, for the views of which the method has an image."""
    views = scene.read("metrics", f"{method}.json").get("views", {})
    return {
        view: numbers["psnr"]
        for view, numbers in views.items()
        if numbers["psnr"] is not None and scene.image(method, view).exists()
    }


def open_picture(results: Results, scene: SceneResults, method: str, view: str) -> Picture:
    """A method's image of a view."""
    layers, _ = read_exr(scene.image(method, view))
    shown = tone_map(layers["radiance"], scene.views.exposure)
    psnr = measured_views(scene, method).get(view)
    return Picture(method, results.methods[method], shown, psnr)


def open_reference(
    results: Results, scene: SceneResults, view: str
) -> tuple[Picture, dict[str, np.ndarray]]:
    """The reference of a view, and all layers of its file."""
    path = scene.image("reference", view)
    if not path.exists():
        raise Missing(f"{scene.name} has no reference of {view}: run `gpf stage reference`")
    layers, record = read_exr(path)
    passes = record.get("passes_done", results.params.reference.passes)
    shown = tone_map(layers["radiance"], scene.views.exposure)
    return Picture("reference", f"Reference, {passes} passes", shown), layers


def best_of_each_system(results: Results, scene: SceneResults) -> list[str]:
    """Of the methods with images, each system's best by PSNR; the field comes last."""
    best: dict[str, tuple[float, str]] = {}
    for method in results.methods:
        psnr = scene.numbers(method).get("psnr")
        if method == SECOND_REFERENCE or psnr is None or not measured_views(scene, method):
            continue
        system = system_of(results, method)
        best[system] = max(best.get(system, (float("-inf"), "")), (psnr, method))
    chosen = [method for _, method in best.values()]
    return sorted(chosen, key=lambda method: method == FIELD)


def decibels(psnr: float | None) -> str:
    """A PSNR as text, `31.4 dB`; "" for None."""
    return "" if psnr is None else f"{psnr:.1f} dB"


def show(axes: Axes, image: np.ndarray, pixels: bool = False) -> None:
    """Draw an image into axes without ticks; with ``pixels``, enlarged pixels stay square."""
    axes.imshow(image, interpolation="nearest" if pixels else "auto")
    axes.set(xticks=[], yticks=[])
    axes.grid(False)
    for spine in axes.spines.values():
        spine.set_visible(False)


def show_error(axes: Axes, error: np.ndarray, pixels: bool = False) -> None:
    """Draw an error map into axes, with the colours of :data:`ERRORS`."""
    show(axes, ERRORS.to_rgba(error)[..., :3], pixels)


def add_error_bar(drawing: Any, axes: Any, **options: Any) -> None:
    """Draw the colour bar of the error maps."""
    ticks = [0, 0.01, 0.05, 0.1, LARGEST_ERROR]
    bar = drawing.colorbar(ERRORS, ax=axes, ticks=ticks, **options)
    bar.ax.set_xticklabels([f"{tick:g}" for tick in ticks])
    bar.set_label("error: mean absolute difference of sRGB values in [0, 1]")
    bar.outline.set_linewidth(0.6)  # type: ignore[operator]


def outline(axes: Axes, corner: tuple[int, int], size: int, letter: str = "") -> None:
    """Draw a frame around a square part of an image, with a letter at its corner."""
    x, y = corner
    for colour, width in (("black", 2.6), ("white", 1.2)):
        axes.add_patch(
            Rectangle((x - 0.5, y - 0.5), size, size, fill=False, edgecolor=colour, linewidth=width)
        )
    if letter:
        put_letter(axes, x, y, letter)


def put_letter(axes: Axes, x: float, y: float, letter: str) -> None:
    """Draw a letter in a box with its upper left corner at a pixel."""
    axes.text(
        x,
        y,
        letter,
        color="black",
        fontsize=8,
        fontweight="bold",
        ha="left",
        va="top",
        bbox={"boxstyle": "square,pad=0.15", "facecolor": "white", "edgecolor": "black", "lw": 0.6},
    )

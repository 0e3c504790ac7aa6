"""Figure of a scene: a view by all systems, with crops at three places where they differ."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas

from report.figures.pictures import (
    Picture,
    add_error_bar,
    best_of_each_system,
    decibels,
    measured_views,
    open_picture,
    open_reference,
    outline,
    put_letter,
    show,
    show_error,
)
from report.figures.places import arriving_light, find_place, focused_light, typical_error
from report.figures.sketch import Missing, Sketch
from report.figures.style import WIDTH, canvas, styled, wrap
from report.results import FIELD, SECOND_REFERENCE, Results, SceneResults

COLUMNS, FEWEST = 10, 5
"""Largest number of pictures in a row, and smallest number of columns."""

PLACES = {
    "A": "where light changes most along surfaces",
    "B": "where the median error of all methods is largest",
    "C": "where the error of GPF is largest",
}


def draw_comparison(results: Results, scene: str) -> Sketch:
    """A view, and crops of it at three places by the best method of each system."""
    found = results.scene(scene)
    methods = best_of_each_system(results, found)
    if FIELD not in methods:
        raise Missing(f"{scene} has no measured images of GPF: run the stages render and metrics")
    view = hardest_view(found)
    reference, layers = open_reference(results, found, view)
    pictures = [open_picture(results, found, m, view) for m in methods if _has(found, m, view)]
    field = pictures[-1]
    size = part_size(reference)
    corners = choose_places(pictures, reference, layers, size)

    shown = [reference, *pictures]
    bands = -(-len(shown) // COLUMNS)
    columns = max(-(-len(shown) // bands), FEWEST)
    with styled():
        width = max(WIDTH, columns * 0.98)
        overview = width / 3 / found.views.aspect + 0.35
        inches = 6 * width / columns + 0.75
        drawing = canvas(overview + bands * inches + 0.6, width)
        parts: Any = drawing.subfigures(
            bands + 1, 1, height_ratios=[overview + 0.6, *[inches] * bands], hspace=0.01
        )
        _draw_overview(parts[0], reference, field, corners, size)
        for part, k in zip(parts[1:], range(0, len(shown), columns), strict=True):
            _draw_band(part, shown[k : k + columns], columns, reference, corners, size)
    return Sketch(drawing, _describe(found, view, pictures), _explain(results, found, view, shown))


def hardest_view(scene: SceneResults) -> str:
    """The novel view with the field's lowest PSNR."""
    measured = measured_views(scene, FIELD)
    return min(measured, key=measured.__getitem__)


def part_size(picture: Picture) -> int:
    """Edge length of the crops, pixels."""
    height, width = picture.shown.shape[:2]
    return min(max(8, height // 4), height, width)


def choose_places(
    pictures: Sequence[Picture], reference: Picture, layers: dict[str, np.ndarray], size: int
) -> list[tuple[int, int]]:
    """Upper left corners (x, y) of the crops at :data:`PLACES`. The last picture is the field's."""
    errors = [picture.error(reference) for picture in pictures]
    names = "position", "normal", "valid"
    focus = errors[-1]
    if all(name in layers for name in (*names, "reflectance")):
        light = arriving_light(layers["radiance"], layers["reflectance"])
        focus = focused_light(light, *(layers[name] for name in names))
    scores = [focus, typical_error(errors), errors[-1]]
    corners: list[tuple[int, int]] = []
    for score in scores:
        corners.append(find_place(score, size, corners))
    return corners


def _has(scene: SceneResults, method: str, view: str) -> bool:
    return view in measured_views(scene, method)


def _draw_overview(
    part: Canvas,
    reference: Picture,
    field: Picture,
    corners: Sequence[tuple[int, int]],
    size: int,
) -> None:
    """Draw the whole view: reference, field, and error map of the field."""
    grid = part.subplots(1, 3)
    show(grid[0], reference.shown)
    show(grid[1], field.shown)
    show_error(grid[2], field.error(reference))
    for letter, corner in zip(PLACES, corners, strict=True):
        outline(grid[0], corner, size, letter)
    grid[0].set_title(reference.title)
    grid[1].set_title(", ".join(filter(None, [field.title, decibels(field.psnr)])))
    grid[2].set_title("Error of GPF")
    add_error_bar(part, list(grid), location="bottom", shrink=0.5, aspect=50, pad=0.03)


def _draw_band(
    part: Canvas,
    pictures: Sequence[Picture],
    columns: int,
    reference: Picture,
    corners: Sequence[tuple[int, int]],
    size: int,
) -> None:
    """Draw the crops of some pictures, with an error map below each crop."""
    grid = part.subplots(2 * len(corners), columns, squeeze=False)
    for column, axes in enumerate(grid.T):
        if column >= len(pictures):
            for one in axes:
                one.remove()
            continue
        picture = pictures[column]
        axes[0].set_title(_heading(picture), fontsize=7.5, fontweight=_weight(picture))
        for row, (letter, (x, y)) in enumerate(zip(PLACES, corners, strict=True)):
            inside = np.s_[y : y + size, x : x + size]
            show(axes[2 * row], picture.shown[inside], pixels=True)
            if picture is reference:
                put_letter(axes[2 * row], -0.5, -0.5, letter)
                _leave_blank(axes[2 * row + 1], "error")
            else:
                show_error(axes[2 * row + 1], picture.error(reference)[inside], pixels=True)


def _heading(picture: Picture) -> str:
    lines = wrap(picture.title, 13).split("\n")
    number = [] if picture.psnr is None else [decibels(picture.psnr)]
    return "\n".join([*lines, *number])


def _weight(picture: Picture) -> str:
    return "bold" if picture.method == FIELD else "normal"


def _leave_blank(axes: Axes, text: str) -> None:
    """Leave a cell of the grid empty, except for the name of its row."""
    axes.set_axis_off()
    axes.set_box_aspect(1)
    axes.text(0.97, 0.5, text, transform=axes.transAxes, ha="right", va="center", fontsize=8)


def _describe(scene: SceneResults, view: str, pictures: Sequence[Picture]) -> str:
    quality = ", ".join(f"{p.title.replace(',', '')} {decibels(p.psnr)}" for p in pictures)
    return (
        f"{scene.title}, view {view}: reference, GPF and its error, then crops of every "
        f"method at three places with error maps. PSNR of the view: {quality}."
    )


def _explain(results: Results, scene: SceneResults, view: str, shown: Sequence[Picture]) -> str:
    places = "; ".join(f"{letter}: {words}" for letter, words in PLACES.items())
    reasons: dict[str, list[str]] = {}
    for method, title in results.methods.items():
        reason = scene.numbers(method).get("reason")
        if reason and method != SECOND_REFERENCE:
            reasons.setdefault(reason, []).append(title)
    missing = [f"{'; '.join(titles)} ({reason})" for reason, titles in reasons.items()]
    without = f" Missing: {'; '.join(missing)}." if missing else ""
    return (
        f"{scene.title}, view “{view}”, the novel view where GPF's PSNR is lowest. "
        f"{places}. Each system is shown by its best method; the numbers are for the whole view."
        f"{without}"
    )

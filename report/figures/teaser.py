"""Figure at the start of the report: four images of the view where the field's lead is largest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure as Canvas

from report.figures.comparison import choose_places, part_size
from report.figures.pictures import (
    Picture,
    decibels,
    measured_views,
    open_picture,
    open_reference,
    outline,
    show,
)
from report.figures.sketch import Missing, Sketch
from report.figures.style import (
    WIDTH,
    canvas,
    seconds_text,
    styled,
    system_of,
    wrap,
)
from report.results import FIELD, SECOND_REFERENCE, Results

RIVALS = ("sppm", "denoised")
"""Systems that the field is compared with."""


@dataclass(frozen=True)
class Choice:
    """A view with metrics of the field and of one method of each rival.

    Attributes
    ----------
    lead: the field's PSNR minus that of the better rival, dB.
    """

    scene: str
    view: str
    methods: tuple[str, ...]
    lead: float


def choose_view(results: Results) -> Choice:
    """The novel view where the field's lead is largest.

    Of the rows of each rival, the one whose time per view is closest to the field's is used.
    """
    choices = []
    for name in results.scenes:
        scene = results.scene(name)
        measured = {m: measured_views(scene, m) for m in results.methods}
        rivals = [_pick(results, name, system, measured) for system in RIVALS]
        if None in rivals:
            continue
        methods = (*(m for m in rivals if m), FIELD)
        for view, psnr in measured[FIELD].items():
            others = [measured[m].get(view) for m in methods[:-1]]
            known = [value for value in others if value is not None]
            if len(known) == len(others) and scene.image("reference", view).exists():
                choices.append(Choice(name, view, methods, psnr - max(known)))
    if not choices:
        raise Missing(
            "no scene has measured images of GPF, SPPM with few passes and a denoised path tracer: "
            "run the stages render, baseline and metrics"
        )
    return max(choices, key=lambda choice: choice.lead)


def _pick(
    results: Results, scene: str, system: str, measured: dict[str, dict[str, float]]
) -> str | None:
    """The method of a system whose time per view is closest to the field's; it must have images."""
    rows = [m for m in results.methods if measured[m] and system_of(results, m) == system]
    seconds = {
        m: results.scene(scene).cost(m, results.params).get("seconds_per_view") for m in rows
    }
    wanted = results.scene(scene).cost(FIELD, results.params).get("seconds_per_view")

    def distance(method: str) -> float:
        own = seconds[method]
        return abs(np.log(own / wanted)) if own and wanted else float("inf")

    return min(rows, key=distance, default=None)


def draw_teaser(results: Results) -> Sketch:
    """Four images of the view with PSNR and time, and crops of each."""
    choice = choose_view(results)
    scene = results.scene(choice.scene)
    pictures = [open_picture(results, scene, m, choice.view) for m in choice.methods]
    reference, layers = open_reference(results, scene, choice.view)
    size = part_size(reference)
    corners = choose_places(pictures, reference, layers, size)[:2]
    shown = [*pictures, reference]
    seconds = {m: scene.cost(m, results.params).get("seconds_per_view") for m in choice.methods}
    seconds["reference"] = scene.cost(SECOND_REFERENCE, results.params).get("seconds_per_view")
    with styled():
        cell = WIDTH / len(shown)
        drawing = canvas(cell / scene.views.aspect + cell / len(corners) + 0.62)
        parts: Any = drawing.subfigures(1, len(shown), wspace=0)
        for part, picture in zip(parts, shown, strict=True):
            _draw_column(part, picture, seconds[picture.method], corners, size, scene.views.aspect)
    numbers = "; ".join(
        f"{p.title.replace(',', '')}, {_numbers(p, seconds[p.method])}" for p in shown
    )
    alt = f"{scene.title}, view {choice.view}, by four methods: {numbers}."
    leads = f"has its largest lead over the others, {choice.lead:.1f} dB"
    if choice.lead < 0:
        leads = f"is closest to the best of the others, {-choice.lead:.1f} dB below it"
    caption = (
        f"{scene.title}, view “{choice.view}”, the novel view where GPF {leads}. Below: crops "
        "where light changes most along surfaces, and where the median error of all methods is "
        "largest. Seconds are for one view, without preparation."
    )
    return Sketch(drawing, alt, caption)


def _draw_column(
    part: Canvas,
    picture: Picture,
    seconds: float | None,
    corners: Sequence[tuple[int, int]],
    size: int,
    aspect: float,
) -> None:
    """Draw an image with its title and numbers, and its crops below."""
    mosaic: Any = [["whole"] * len(corners), [f"{k}" for k in range(len(corners))]]
    axes = part.subplot_mosaic(mosaic, height_ratios=[len(corners) / aspect, 1])
    show(axes["whole"], picture.shown)
    axes["whole"].set_title(wrap(picture.title, 22), fontsize=9)
    axes["whole"].set_xlabel(_numbers(picture, seconds), fontsize=9)
    for k, (x, y) in enumerate(corners):
        outline(axes["whole"], (x, y), size)
        show(axes[f"{k}"], picture.shown[y : y + size, x : x + size], pixels=True)


def _numbers(picture: Picture, seconds: float | None) -> str:
    time = "" if seconds is None else seconds_text(seconds)
    return ", ".join(filter(None, [decibels(picture.psnr), time]))

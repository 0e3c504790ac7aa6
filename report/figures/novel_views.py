"""Figure of a scene: the field and the reference in all novel views."""

from __future__ import annotations

from report.figures.pictures import (
    add_error_bar,
    decibels,
    measured_views,
    open_picture,
    open_reference,
    show,
    show_error,
)
from report.figures.sketch import Missing, Sketch
from report.figures.style import WIDTH, canvas, styled
from report.results import FIELD, Results

COLUMNS, FEWEST = 6, 3
"""Largest number of views in a row, and smallest number of columns."""


def draw_novel_views(results: Results, scene: str) -> Sketch:
    """A column for each view: field, reference and error map."""
    found = results.scene(scene)
    measured = measured_views(found, FIELD)
    names = [view.name for view in found.views.novel if view.name in measured]
    if not names:
        raise Missing(f"{scene} has no measured images of GPF: run the stages render and metrics")
    bands = -(-len(names) // COLUMNS)
    columns = max(-(-len(names) // bands), FEWEST)
    with styled():
        inches = 3 * WIDTH / columns / found.views.aspect + 0.3
        drawing = canvas(bands * inches + 0.55)
        grid = drawing.subplots(3 * bands, columns, squeeze=False)
        for axes in grid.flat:
            axes.set_axis_off()
        for k, name in enumerate(names):
            band, column = divmod(k, columns)
            field = open_picture(results, found, FIELD, name)
            reference, _ = open_reference(results, found, name)
            rows = grid[3 * band : 3 * band + 3, column]
            for axes in rows:
                axes.set_axis_on()
            show(rows[0], field.shown)
            show(rows[1], reference.shown)
            show_error(rows[2], field.error(reference))
            rows[0].set_title(f"{name}\n{decibels(field.psnr)}", fontsize=8.5, fontweight="normal")
            if column == 0:
                for axes, label in zip(rows, ("GPF", "reference", "error"), strict=True):
                    axes.set_ylabel(label)
        add_error_bar(drawing, list(grid.flat), location="bottom", shrink=0.5, aspect=50, pad=0.01)
    alt = (
        f"{found.title}: {len(names)} novel views by GPF, their references below, and error maps. "
        f"PSNR: {', '.join(f'{name} {decibels(measured[name])}' for name in names)}."
    )
    caption = (
        f"{found.title}: all novel views, which were not used in training, with the PSNR of GPF "
        f"({results.params.render.spp} samples per pixel)."
    )
    return Sketch(drawing, alt, caption)

"""The figures of the report, one module each.

They share :mod:`report.figures.style` (fonts, markers, dashes), :mod:`report.figures.sketch`
(files) and :mod:`report.figures.pictures` (images of methods).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

from report.figures.comparison import draw_comparison
from report.figures.convergence import draw_convergence
from report.figures.cumulative_cost import draw_cumulative_cost
from report.figures.novel_views import draw_novel_views
from report.figures.quality_time import draw_quality_time
from report.figures.sketch import Figure, Missing, Sketch, leave_out, save
from report.figures.teaser import draw_teaser
from report.figures.training import draw_training
from report.results import Results

__all__ = ["Figure", "draw_figures"]


def draw_figures(results: Results, folder: Path) -> list[Figure]:
    """Write all figures into a folder, as SVG and PNG; identical results give identical files.

    A figure without data has a ``reason`` instead of files, and its old files are removed.
    """
    figures = []
    for name, title, draw, scene in _plan(results):
        try:
            figures.append(save(draw(results), name, title, folder, scene))
        except Missing as missing:
            figures.append(leave_out(name, title, str(missing), folder, scene))
    return figures


def _plan(results: Results) -> Iterator[tuple[str, str, Callable[[Results], Sketch], str]]:
    """Names, titles, drawing functions and scenes (or ""), in the order of the report."""
    yield "teaser", "The field beside other methods", draw_teaser, ""
    for scene in results.scenes:
        title = results.scene(scene).title
        methods, views = (partial(d, scene=scene) for d in (draw_comparison, draw_novel_views))
        yield f"comparison_{scene}", f"{title}: methods", methods, scene
        yield f"views_{scene}", f"{title}: novel views", views, scene
    yield "quality_time", "Quality over time", draw_quality_time, ""
    yield "cumulative_cost", "Cost of many views", draw_cumulative_cost, ""
    yield "convergence", "Convergence of SPPM", draw_convergence, ""
    yield "training", "Training", draw_training, ""

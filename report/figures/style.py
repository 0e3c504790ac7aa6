"""The style of all figures. In black and white, shapes, fillings and dashes tell methods apart."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from matplotlib.ticker import FuncFormatter, NullFormatter

from report.results import FIELD, SECOND_REFERENCE, Results

WIDTH = 8.0
"""Width in inches. A README shows it at about 880 pixels, so that 8 points are 12 pixels."""

DPI = 150

RC: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 8.5,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.labelsize": 8.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.8,
    "axes.grid": True,
    "grid.color": "0.9",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "lines.linewidth": 1.6,
    "lines.markersize": 5.5,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    # The ids in SVG files depend on this salt instead of a random number.
    "svg.hashsalt": "gpf",
}

BLACK, STRONG, GREY = "black", "#0060a8", "0.45"
"""Colours of the field, of SPPM, and of the background."""


@dataclass(frozen=True)
class Mark:
    """The marker of a method in plots."""

    marker: str
    colour: str
    size: float = 6.5


_SYSTEMS = {
    "sppm": Mark("o", STRONG),
    "path_tracer": Mark("s", "#d55e00"),
    "denoised": Mark("D", "#8a3a6e", 6),
    "cycles": Mark("p", "#e87d0d", 7),
    "luxcore": Mark("H", "#00857d", 7),
    "particle_tracer": Mark("^", "#e6a100", 7),
    "em_gmm": Mark("X", "#7f7f7f", 7.5),
    "radiance_cache": Mark("P", "#009e73", 7.5),
    "instant_ngp": Mark("v", "#48a9dd", 7),
    "splatting": Mark("<", "#5b3a94", 7),
    "renderformer": Mark(">", "#7a4a2b", 7),
    "anysplat": Mark("h", "#b8b020", 7.5),
}
_FIELD = Mark("*", BLACK, 13)
_SECOND_REFERENCE = Mark("o", STRONG)
_OTHER = Mark("d", GREY, 7)
_FILLINGS = ("full", "none", "left", "top")


def system_of(results: Results, method: str) -> str:
    """The system of a row of `baselines`; for other methods their own name."""
    row = results.params.baselines.get(method)
    return str(row.system) if row else method


def marks(results: Results) -> dict[str, dict[str, Any]]:
    """Keyword arguments of ``Axes.plot`` for each method: the shape depends on the system, the
    filling on its row."""
    rows: dict[str, int] = {}
    found = {}
    for method in results.methods:
        system = system_of(results, method)
        row = rows[system] = rows.get(system, -1) + 1
        mark = _SYSTEMS.get(system, _OTHER)
        mark = {FIELD: _FIELD, SECOND_REFERENCE: _SECOND_REFERENCE}.get(method, mark)
        found[method] = {
            "marker": mark.marker,
            "color": mark.colour,
            "markersize": mark.size,
            "fillstyle": _FILLINGS[row % len(_FILLINGS)],
            "markerfacecoloralt": "white",
            "markeredgewidth": 1.3,
            "linestyle": "none",
        }
    return found


def wrap(title: str, width: int) -> str:
    """A method's title on several lines, with a line break after each comma."""
    return "\n".join(
        line for part in title.split(", ") for line in textwrap.wrap(part, width) or [part]
    )


def seconds_text(seconds: float) -> str:
    """A time as text: 0.57 s, 24 s, 3.1 min, 2.3 h."""
    for unit, length in (("h", 3600), ("min", 60)):
        if seconds >= 2 * length:
            return f"{seconds / length:.2g} {unit}"
    return f"{seconds:.0f} s" if seconds >= 10 else f"{seconds:.2g} s"


def canvas(height: float, width: float = WIDTH, **options: Any) -> Canvas:
    """An empty drawing with a layout that avoids overlaps."""
    return Canvas(figsize=(width, height), dpi=DPI, layout="constrained", **options)


@contextmanager
def styled() -> Iterator[None]:
    """Use the style of the figures."""
    with rc_context(RC):
        yield


def small_multiples(
    titles: Sequence[str], x: str, y: str, height: float = 2.3
) -> tuple[Canvas, list[Axes], list[Axes]]:
    """A drawing with a panel for each title, three in a row; its panels, and unused axes.

    ``x`` and ``y`` are the labels of all axes.
    """
    # With few panels, one column is left for the legend.
    count, columns = len(titles), min(3, len(titles) + 1)
    rows = -(-count // columns)
    drawing = canvas(height * rows + (0.7 if count % columns == 0 else 0), WIDTH)
    drawing.supylabel(y, fontsize=RC["axes.labelsize"])
    grid = list(np.ravel(drawing.subplots(rows, columns, squeeze=False)))
    for axes, title in zip(grid, titles, strict=False):
        axes.set_title(title)
        axes.set_xlabel(x)
    for axes in grid[count:]:
        axes.set_axis_off()
    return drawing, grid[:count], grid[count:]


def plain_numbers(axis: Any) -> None:
    """Label a logarithmic axis with 0.1, 1, 10, 1000 instead of powers of ten."""
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def put_legend(drawing: Canvas, spare: Sequence[Axes], handles: Mapping[str, Any]) -> None:
    """Draw one legend for all panels: in unused axes, or below the panels."""
    lines, labels = list(handles.values()), list(handles)
    if spare and len(labels) <= 12:
        spare[0].legend(lines, labels, loc="center left")
    else:
        drawing.legend(lines, labels, loc="outside lower center", ncols=3)


def gather_legend(panels: Sequence[Axes]) -> dict[str, Any]:
    """Label -> line, from all panels, in the order of their first use."""
    found: dict[str, Any] = {}
    for axes in panels:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    return found

"""Figure of the total cost over the number of views, with the break-even points of the field."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from metrics.cost import GPF, SPPM, SPPM_AT_EQUAL_QUALITY, SPPM_TOGETHER
from report.figures.sketch import Missing, Sketch
from report.figures.style import (
    BLACK,
    STRONG,
    gather_legend,
    plain_numbers,
    put_legend,
    small_multiples,
    styled,
)
from report.paper import read_paper
from report.results import Results

_LINES: dict[str, dict[str, Any]] = {
    GPF: {"color": BLACK, "linestyle": "-", "linewidth": 2.2},
    SPPM: {"color": STRONG, "linestyle": "--"},
    SPPM_AT_EQUAL_QUALITY: {"color": "0.5", "linestyle": (0, (1, 1)), "linewidth": 2.2},
    SPPM_TOGETHER: {"color": STRONG, "linestyle": "-.", "linewidth": 0.9},
}


def draw_cumulative_cost(results: Results) -> Sketch:
    """A panel for each scene with a file of the stage `amortize`."""
    found = {s: results.scene(s).read("amortize.json") for s in results.scenes}
    known = {"break_even_views", "passes", "preparation_seconds", "seconds_per_view"}
    found = {s: c for s, c in found.items() if known <= c.keys() and _has_all_lines(c)}
    if not found:
        raise Missing("no scene has an amortize.json: run the stage amortize")
    last = results.params.amortize.views
    with styled():
        titles = [results.scene(scene).title for scene in found]
        drawing, panels, spare = small_multiples(titles, "views", "seconds, preparation included")
        passes = results.passes
        labels = {
            GPF: "GPF",
            SPPM: f"SPPM, {passes} passes",
            SPPM_AT_EQUAL_QUALITY: "SPPM at GPF's PSNR",
            SPPM_TOGETHER: "SPPM, views together",
        }
        for axes, cost in zip(panels, found.values(), strict=True):
            _draw_panel(axes, cost, last, labels)
        put_legend(drawing, spare, gather_legend(panels))
    paper = read_paper().cost
    words = "; ".join(f"{results.scene(s).title}: {_text_of(c, passes)}" for s, c in found.items())
    alt = f"Cumulative cost in seconds over 1 to {last} views, on logarithmic axes. {words}."
    caption = (
        f"Total seconds for 1 to {last} views. Circles, labelled with the number of views, mark "
        "the break-even points: from there on, GPF is cheaper in total, including its preparation. "
        f"{words}. SPPM at GPF's PSNR has no line if SPPM did not reach it. SPPM can render "
        "views together, from the same photons, if they are known in advance; GPF does not need "
        f"this. The paper reports {paper.total_hours:g} hours of preparation, which pay off from "
        f"view {paper.break_even_views} on."
    )
    return Sketch(drawing, alt, caption)


def _has_all_lines(cost: dict[str, Any]) -> bool:
    """Whether the file has a time for each line; files of older versions may lack some."""
    return _LINES.keys() <= cost["seconds_per_view"].keys()


def _draw_panel(axes: Axes, cost: dict[str, Any], last: int, labels: dict[str, str]) -> None:
    views = np.arange(1, last + 1)
    per_view = cost["seconds_per_view"]
    drawn = [name for name in _LINES if name != SPPM_AT_EQUAL_QUALITY or not _is_bound(cost)]
    for name in drawn:
        start = cost["preparation_seconds"] if name == GPF else 0
        zorder = 3 if name == GPF else 2
        total = start + views * per_view[name]
        axes.plot(views, total, zorder=zorder, label=labels[name], **_LINES[name])
    evens = (cost["break_even_views"][name] for name in drawn if name != GPF)
    counts = {n for n in evens if n is not None and n <= last}
    for count in sorted(counts):
        height = cost["preparation_seconds"] + count * per_view[GPF]
        axes.plot(count, height, "o", color=BLACK, markerfacecolor="white", zorder=4, markersize=7)
        if min(counts) < count < max(counts):
            continue
        # On the side without lines; the lines of SPPM rise from left to right.
        above = count == min(counts) < max(counts)
        axes.annotate(
            f"{count}",
            (count, height),
            textcoords="offset points",
            xytext=(-6, 6) if above else (6, -6),
            ha="right" if above else "left",
            va="bottom" if above else "top",
        )
    axes.set(xscale="log", yscale="log", xlim=(1, last))
    plain_numbers(axes.xaxis)
    plain_numbers(axes.yaxis)


def _text_of(cost: dict[str, Any], passes: str) -> str:
    def words(line: str, rival: str) -> str:
        count = cost["break_even_views"][line]
        cheaper = f"cheaper than {rival}"
        return f"never {cheaper}" if count is None else f"{cheaper} from view {count} on"

    rival = f"SPPM with {passes} passes"
    if _is_bound(cost):
        return words(SPPM, f"{rival}, which has a lower PSNR,")
    equal = f"SPPM with the same PSNR ({cost['passes'][SPPM_AT_EQUAL_QUALITY]} passes)"
    return f"{words(SPPM, rival)} and {words(SPPM_AT_EQUAL_QUALITY, equal)}"


def _is_bound(cost: dict[str, Any]) -> bool:
    """Whether SPPM did not reach the field's PSNR, so that the number of passes is a bound."""
    return str(cost["passes"][SPPM_AT_EQUAL_QUALITY]).startswith(">")

"""Figure of PSNR over time: a point for each method, and a curve for SPPM."""

from __future__ import annotations

from collections.abc import Mapping

import pandas as pd
from matplotlib.axes import Axes

from report.figures.sketch import Missing, Sketch
from report.figures.style import (
    STRONG,
    gather_legend,
    marks,
    plain_numbers,
    put_legend,
    small_multiples,
    styled,
)
from report.results import FIELD, SECOND_REFERENCE, Results, SceneResults

CURVE = "SPPM with the reference settings, by passes"


def sppm_curve(scene: SceneResults) -> tuple[list[float], list[float]]:
    """Seconds per view and PSNR of SPPM by number of passes; empty if either is unknown."""
    seconds, curve = scene.seconds_per_pass, scene.convergence
    if seconds is None:
        return [], []
    return [passes * seconds for passes in curve], list(curve.values())


def draw_quality_time(results: Results) -> Sketch:
    """A panel for each scene with at least two methods."""
    table = results.quality.dropna(subset=["psnr", "seconds_per_view"])
    table = table[(table["method"] != SECOND_REFERENCE) & (table["seconds_per_view"] > 0)]
    scenes = [s for s in results.scenes if (table["scene"] == s).sum() > 1]
    if not scenes:
        raise Missing(
            "no scene has two methods with a PSNR and a time: run the stages render, baseline and "
            "metrics"
        )
    with styled():
        titles = [results.scene(scene).title for scene in scenes]
        drawing, panels, spare = small_multiples(titles, "seconds per view", "PSNR, dB", 2.6)
        styles = marks(results)
        for axes, scene in zip(panels, scenes, strict=True):
            _draw_panel(axes, results.scene(scene), table, styles)
        legend, order = gather_legend(panels), [CURVE, *results.methods.values()]
        put_legend(drawing, spare, {title: legend[title] for title in order if title in legend})
    return Sketch(drawing, _describe(table, dict(zip(scenes, titles, strict=True))), _CAPTION)


def _draw_panel(
    axes: Axes, scene: SceneResults, table: pd.DataFrame, styles: dict[str, dict]
) -> None:
    seconds, psnr = sppm_curve(scene)
    if seconds:
        axes.plot(seconds, psnr, ".-", color=STRONG, markersize=4, zorder=1, label=CURVE)
    for row in table[table["scene"] == scene.name].itertuples():
        front = 4 if row.method == FIELD else 3
        style = styles[row.method] | {"zorder": front, "label": row.title}
        axes.plot(row.seconds_per_view, row.psnr, **style)
    axes.set_xscale("log")
    axes.margins(0.08)
    plain_numbers(axes.xaxis)


_CAPTION = (
    "PSNR over the time per view, as means over novel views. Up and to the left is better. The "
    "time excludes preparation (training, and all else that is computed once per scene); see the "
    "cost of many views."
)


def _describe(table: pd.DataFrame, titles: Mapping[str, str]) -> str:
    parts = []
    for scene in titles:
        rows = table[table["scene"] == scene].sort_values("psnr", ascending=False)
        best = rows.iloc[0]
        parts.append(
            f"{titles[scene]}: highest is {best['title'].replace(',', '')} with "
            f"{best['psnr']:.1f} dB at {best['seconds_per_view']:.2g} s per view"
        )
    return f"Scatter plots of PSNR over seconds per view. {'; '.join(parts)}."

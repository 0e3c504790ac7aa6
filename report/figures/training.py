"""Figure of the field's training error over the steps."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd

from report.figures.sketch import Missing, Sketch
from report.figures.style import (
    BLACK,
    GREY,
    gather_legend,
    put_legend,
    small_multiples,
    styled,
)
from report.results import Results

CURVES: dict[str, tuple[str, dict[str, Any]]] = {
    "held_out_error": ("held-out points", {"color": BLACK, "marker": "o"}),
    "training_error": ("training points", {"color": GREY, "linestyle": "--", "marker": "x"}),
}
"""Curves that `gpf stage train` logs -> label and style."""


def read_curve(folder: Path, name: str) -> pd.DataFrame:
    """A curve that DVCLive wrote, columns ``step`` and ``name``; empty if there is no file."""
    path = folder / "plots" / "metrics" / f"{name}.tsv"
    if not path.exists():
        return pd.DataFrame({"step": [], name: []})
    return pd.read_csv(path, sep="\t")


def draw_training(results: Results) -> Sketch:
    """A panel for each scene with training curves."""
    found = {}
    for scene in results.scenes:
        folder = results.scene(scene).folder / "training"
        curves = {name: read_curve(folder, name) for name in CURVES}
        # With `train.held_out: 0`, the error of held-out points is logged as 0; leave it out.
        curves = {name: curve for name, curve in curves.items() if curve[name].any()}
        if curves:
            found[scene] = curves
    if not found:
        raise Missing("no scene has training curves: run the stage train")
    with styled():
        titles = [results.scene(scene).title for scene in found]
        drawing, panels, spare = small_multiples(titles, "step", "weighted error / mean target")
        for axes, curves in zip(panels, found.values(), strict=True):
            for name, curve in curves.items():
                label, style = CURVES[name]
                sparse = max(1, len(curve) // 10)
                axes.plot(
                    curve["step"], curve[name], label=label, markevery=sparse, markersize=4, **style
                )
            axes.set_ylim(bottom=0)
        put_legend(drawing, spare, gather_legend(panels))
    lasts = {scene: next(iter(curves.items())) for scene, curves in found.items()}
    ends = "; ".join(
        f"{results.scene(scene).title}: {curve[name].iloc[-1]:.2g}"
        for scene, (name, curve) in lasts.items()
    )
    alt = f"Training curves: the field's error over the steps. At the end: {ends}."
    held_out = any("held_out_error" in curves for curves in found.values())
    caption = (
        "Root mean square error of the field's irradiance at the supervised points, weighted as in "
        "the loss (train.loss), divided by the mean target."
        + (" The state with the lowest error at held-out points is kept." if held_out else "")
    )
    return Sketch(drawing, alt, caption)

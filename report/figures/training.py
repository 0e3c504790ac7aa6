"""How the field's error fell while it was trained."""

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
    "held_out_error": ("points that no step saw", {"color": BLACK, "marker": "o"}),
    "training_error": ("points of the steps", {"color": GREY, "linestyle": "--", "marker": "x"}),
}
"""Curves that `gpf stage train` logs, and how they are drawn."""


def read_curve(folder: Path, name: str) -> pd.DataFrame:
    """A curve that DVCLive wrote below ``folder``: columns ``step`` and ``name``; may be empty."""
    path = folder / "plots" / "metrics" / f"{name}.tsv"
    if not path.exists():
        return pd.DataFrame({"step": [], name: []})
    return pd.read_csv(path, sep="\t")


def draw_training(results: Results) -> Sketch:
    """A panel for each scene with a field."""
    found = {}
    for scene in results.scenes:
        folder = results.scene(scene).folder / "training"
        curves = {name: read_curve(folder, name) for name in CURVES}
        # With `train.held_out: 0` there are no points that no step saw.
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
    alt = f"Training curves: the field's error over steps, falling. At the end: {ends}."
    judged = any("held_out_error" in curves for curves in found.values())
    caption = (
        "Root mean square error of the field's irradiance at supervised points, weighted like the "
        "loss (train.loss), over the mean target."
        + (" The points that no step saw judge; the best state is kept." if judged else "")
    )
    return Sketch(drawing, alt, caption)

"""Photon mapping's quality by passes, and where the field stands."""

from __future__ import annotations

from collections.abc import Mapping

from matplotlib.axes import Axes

from metrics.equivalent_passes import EquivalentPasses, equivalent_passes
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
from report.results import FIELD, Results


def draw_convergence(results: Results) -> Sketch:
    """A panel for each scene whose SPPM was measured at several numbers of passes."""
    curves = {s: results.scene(s).convergence for s in results.scenes}
    curves = {scene: curve for scene, curve in curves.items() if len(curve) > 1}
    if not curves:
        raise Missing("no scene has a convergence.json: run the stages reference and metrics")
    words = []
    with styled():
        titles = [results.scene(scene).title for scene in curves]
        drawing, panels, spare = small_multiples(titles, "passes", "PSNR, dB")
        for axes, (scene, curve) in zip(panels, curves.items(), strict=True):
            level = results.scene(scene).numbers(FIELD).get("psnr")
            _draw_panel(axes, curve, level)
            if level is not None:
                worth = equivalent_passes(level, curve)
                words.append(f"{axes.get_title()}: {level:.1f} dB, as SPPM after {_tell(worth)}")
        put_legend(drawing, spare, gather_legend(panels))
    text = "; ".join(words)
    alt = f"PSNR of SPPM over the number of passes, with the PSNR of GPF as a level. {text}."
    caption = (
        "PSNR of a second, independent SPPM against the reference, means over novel views, and the "
        f"level of GPF. {text}. The reference has noise of its own, and so has this SPPM: what "
        "both add up to bounds its PSNR; that of an image without noise is bounded by the "
        "reference's alone."
    )
    return Sketch(drawing, alt, caption)


def _tell(worth: EquivalentPasses) -> str:
    bound = {"<": "less than ", ">": "more than ", "": ""}[worth.bound]
    return f"{bound}{str(worth).strip('<>')} passes"


def _draw_panel(axes: Axes, curve: Mapping[int, float], level: float | None) -> None:
    axes.plot(list(curve), list(curve.values()), "o-", color=STRONG, label="SPPM", markersize=4.5)
    axes.set_xscale("log")
    axes.margins(y=0.14)
    plain_numbers(axes.xaxis)
    if level is None:
        return
    axes.axhline(level, color=BLACK, linestyle="--", label="GPF", zorder=1)
    axes.annotate(
        f"GPF {level:.1f} dB",
        (0, level),
        xycoords=("axes fraction", "data"),
        xytext=(4, -4),
        textcoords="offset points",
        va="top",  # above, the title is near; the curve begins far below
    )
    worth = equivalent_passes(level, curve)
    if not worth.bound:
        axes.plot(worth.passes, level, "*", color=BLACK, markersize=12, zorder=4)

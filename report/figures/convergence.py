"""Figure of SPPM's PSNR over the number of passes, with the field's PSNR."""

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
    """A panel for each scene with SPPM at several numbers of passes."""
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
                equivalent = _text_of(equivalent_passes(level, curve))
                words.append(f"{axes.get_title()}: {level:.1f} dB, like SPPM with {equivalent}")
        put_legend(drawing, spare, gather_legend(panels))
    text = "; ".join(words)
    alt = f"PSNR of SPPM over the number of passes, with the PSNR of GPF as a line. {text}."
    caption = (
        "PSNR of the second reference, an independent SPPM run, against the reference, as means "
        f"over novel views, and the PSNR of GPF. {text}. Both the reference and this run are "
        "noisy, and their combined noise limits the PSNR of SPPM. The PSNR of an image without "
        "noise is limited only by the noise of the reference."
    )
    return Sketch(drawing, alt, caption)


def _text_of(equivalent: EquivalentPasses) -> str:
    bound = {"<": "fewer than ", ">": "more than ", "": ""}[equivalent.bound]
    return f"{bound}{str(equivalent).strip('<>')} passes"


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
        va="top",  # the title is above; the curve starts far below
    )
    equivalent = equivalent_passes(level, curve)
    if not equivalent.bound:
        axes.plot(equivalent.passes, level, "*", color=BLACK, markersize=12, zorder=4)

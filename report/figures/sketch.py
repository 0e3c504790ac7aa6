"""Drawings, and their files."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path

from matplotlib import rc_context
from matplotlib.figure import Figure as Canvas

from gpf.core.files import write_atomically
from report.figures.style import RC


class Missing(Exception):
    """A figure has no data; the message says what is missing and which stages to run."""


@dataclass(frozen=True)
class Sketch:
    """A drawing with its texts.

    Attributes
    ----------
    alt: describes it for people who cannot see it.
    caption: the text below it.
    """

    canvas: Canvas
    alt: str
    caption: str


@dataclass(frozen=True)
class Figure:
    """A figure of the report.

    Attributes
    ----------
    name: base name of its files, without suffix.
    title, alt, caption: its texts; ``alt`` describes it for people who cannot see it.
    svg, png: its files; None if it was left out.
    reason: why it was left out, or "".
    scene: its scene; "" for a figure of all scenes.
    """

    name: str
    title: str
    alt: str = ""
    caption: str = ""
    svg: Path | None = None
    png: Path | None = None
    reason: str = ""
    scene: str = ""


def save(sketch: Sketch, name: str, title: str, folder: Path, scene: str = "") -> Figure:
    """Write a drawing as SVG and PNG, without dates or random ids: the same bytes each time."""
    svg, png = (folder / f"{name}.{suffix}" for suffix in ("svg", "png"))
    words = {"Title": title, "Description": sketch.alt}
    with rc_context(RC):
        for path, metadata in ((svg, {"Date": None, **words}), (png, words)):
            write_atomically(path, partial(sketch.canvas.savefig, metadata=metadata))
            # The PNG reuses the layout of the SVG: arranging everything again takes as long as
            # drawing it.
            sketch.canvas.set_layout_engine("none")
    return Figure(name, title, sketch.alt, sketch.caption, svg, png, scene=scene)


def leave_out(name: str, title: str, reason: str, folder: Path, scene: str = "") -> Figure:
    """Remove the files of an earlier call; the figure has the reason instead."""
    for suffix in ("svg", "png"):
        (folder / f"{name}.{suffix}").unlink(missing_ok=True)
    return Figure(name, title, reason=reason, scene=scene)

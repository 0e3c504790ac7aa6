"""From a drawing to files, and what the report is told of them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path

from matplotlib import rc_context
from matplotlib.figure import Figure as Canvas

from gpf.core.files import write_atomically
from report.figures.style import RC


class Missing(Exception):
    """What a figure would show is not there; the message says what, and how to get it."""


@dataclass(frozen=True)
class Sketch:
    """A drawing and the words that go with it.

    Attributes
    ----------
    alt: what it shows, for somebody who does not see it.
    caption: what stands below it.
    """

    canvas: Canvas
    alt: str
    caption: str


@dataclass(frozen=True)
class Figure:
    """A figure of the report.

    Attributes
    ----------
    name: of its files, without suffix.
    title, alt, caption: in words; ``alt`` is for somebody who does not see it.
    svg, png: its files; None where it was left out.
    reason: why it was left out; empty where it was not.
    scene: which it is of; empty where it is of all.
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
    """Write a drawing as SVG and PNG. Without dates and random ids, equal drawings are equal."""
    svg, png = (folder / f"{name}.{suffix}" for suffix in ("svg", "png"))
    words = {"Title": title, "Description": sketch.alt}
    with rc_context(RC):
        for path, metadata in ((svg, {"Date": None, **words}), (png, words)):
            write_atomically(path, partial(sketch.canvas.savefig, metadata=metadata))
    return Figure(name, title, sketch.alt, sketch.caption, svg, png, scene=scene)


def leave_out(name: str, title: str, reason: str, folder: Path, scene: str = "") -> Figure:
    """Remove what an earlier call wrote, and say why there is nothing."""
    for suffix in ("svg", "png"):
        (folder / f"{name}.{suffix}").unlink(missing_ok=True)
    return Figure(name, title, reason=reason, scene=scene)

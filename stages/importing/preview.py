"""A contact sheet of a scene's views: path tracer and SPPM side by side, with the views' faults."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import mitsuba as mi
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from gpf.core.files import write_atomically
from gpf.core.images import tone_map
from gpf.photons.tracing import PathSettings
from gpf.placement.view_checks import ViewReport, report_views
from gpf.scene.sensors import make_sensor
from gpf.scene.views import SceneViews, View
from gpf.sppm.passes import PassSettings, propose_radius
from stages.importing.report import PHOTONS
from stages.references.renderer import ReferenceRenderer

Font = ImageFont.FreeTypeFont | ImageFont.ImageFont

_DEPTH = 16

# The sheet: pairs of pictures per row, and sizes in pixels.
_COLUMNS = 4
_GAP, _MARGIN = 4, 10
_TITLE_SIZE, _LABEL_SIZE = 15, 12


@dataclass(frozen=True)
class Preview:
    """One view, rendered by two methods.

    Attributes
    ----------
    use: the list that the view comes from: train, more, novel or path.
    faults: what is wrong with the view, in words.
    path, sppm: radiance by path tracing and by photon mapping, linear, (H, W, 3).
    """

    view: View
    use: str
    report: ViewReport
    faults: list[str]
    path: np.ndarray
    sppm: np.ndarray


def render_previews(
    scene: mi.Scene,
    views: SceneViews,
    chosen: Sequence[tuple[View, str]],
    height: int = 96,
    spp: int = 16,
    passes: int = 8,
    tick: Callable[[], None] = lambda: None,
) -> list[Preview]:
    """Render V views with both methods; call ``tick()`` after each of the ``passes`` + V steps.

    All views share the photons of a pass.
    """
    size = views.size(height)
    reports = report_views(scene, [view for view, _ in chosen], views.aspect)
    sensors = {view.name: make_sensor(view, *size, spp=spp) for view, _ in chosen}
    # A small radius: other views may be brighter than the first and have many more photons.
    radius = propose_radius(scene, reports[0].points, PathSettings(PHOTONS), photons_in_disc=4)
    settings = PassSettings(photons_per_pass=PHOTONS, initial_radius=radius, direct="photons")
    photon_mapping = ReferenceRenderer(scene, sensors, {}, settings, seed=0)
    sums = photon_mapping.run(passes, tick=lambda _: tick())
    tracer = mi.load_dict({"type": "path", "max_depth": _DEPTH})
    previews = []
    for (view, use), report in zip(chosen, reports, strict=True):
        image = np.array(mi.render(scene, sensor=sensors[view.name], integrator=tracer, spp=spp))
        mapped = photon_mapping.image(view.name, sums)
        # The author placed the first camera on purpose, even if it is inside something, like water.
        faults = report.faults(home_inside=reports[0].inside)
        previews.append(Preview(view, use, report, faults, image, mapped))
        tick()
    return previews


def choose_views(views: SceneViews, whole: bool = False) -> list[tuple[View, str]]:
    """The views of a contact sheet, each with the list that it comes from.

    At most 8 evenly chosen training views, all of ``more``, all novel views, and three or four
    frames of the path; with ``whole``, all training views and all frames.
    """
    train, frames = views.train, views.frames()
    if not whole:
        train = train[:: -(-len(train) // 8)]
        frames = frames[:: max(1, len(frames) // 3)]
    kinds = {"train": train, "more": views.more, "novel": views.novel, "path": frames}
    return [(view, use) for use, members in kinds.items() for view in members]


def draw_contact_sheet(
    path: Path, title: str, previews: Sequence[Preview], exposure: float
) -> None:
    """Write a PNG: for each view its label and faults above two pictures, path tracer and SPPM."""
    large, small = (ImageFont.load_default(size) for size in (_TITLE_SIZE, _LABEL_SIZE))
    height, width = previews[0].path.shape[:2]
    pair = 2 * width + _GAP
    columns = min(_COLUMNS, len(previews))
    rows = -(-len(previews) // columns)
    total = _MARGIN + columns * (pair + _MARGIN)
    title = _wrap([title], large, total - 2 * _MARGIN)
    labels = [_wrap([f"{p.use}: {p.view.name}", *p.faults], small, pair) for p in previews]

    top = _text_height(title, large) + 2 * _MARGIN
    words = max(_text_height(label, small) for label in labels) + _GAP
    row_height = words + height + _MARGIN
    sheet = Image.new("RGB", (total, top + rows * row_height), "white")
    draw = ImageDraw.Draw(sheet)
    draw.text((_MARGIN, _MARGIN), title, "black", large)
    for k, (preview, label) in enumerate(zip(previews, labels, strict=True)):
        x, y = _MARGIN + k % columns * (pair + _MARGIN), top + k // columns * row_height
        draw.text((x, y), label, "crimson" if preview.faults else "black", small)
        for i, image in enumerate((preview.path, preview.sppm)):
            shown = np.round(tone_map(image, exposure) * 255).astype(np.uint8)
            sheet.paste(Image.fromarray(shown), (x + i * (width + _GAP), y + words))
    write_atomically(path, lambda file: sheet.save(file, format="PNG"))


def _wrap(texts: Sequence[str], font: Font, width: int) -> str:
    """Texts one below the other, in lines of at most about ``width`` pixels."""
    letters = max(4, int(width / font.getlength("abcdefghij") * 10))
    return "\n".join(line for text in texts for line in textwrap.wrap(text, letters))


def _text_height(text: str, font: Font) -> int:
    draw = ImageDraw.Draw(Image.new("RGB", (1, 1)))
    return round(draw.multiline_textbbox((0, 0), text, font)[3])

"""Frames of several methods side by side, as an MP4 and as an animated WebP."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from gpf.core.files import write_atomically

GAP = 8
PAPER, INK, BLANK = (255, 255, 255), (0, 0, 0), (222, 222, 222)

FILM_HEIGHTS = 256, 384
"""Smallest and largest height of a panel in the MP4, pixels."""

WEBP_WIDTH, WEBP_BYTES = 960, 3_000_000
"""Largest width, in pixels, and file size of the WebP, which is meant for a README."""


@dataclass(frozen=True)
class Reel:
    """The content of one panel.

    Attributes
    ----------
    title: text above the panel.
    frames: sRGB, 8 bits, each (H, W, 3); empty if the method has no frames.
    reason: shown in place of frames.
    """

    title: str
    frames: Sequence[np.ndarray]
    reason: str = ""


def compose(reels: Sequence[Reel], panel: tuple[int, int]) -> list[Image.Image]:
    """All frames with the panels side by side; ``panel``: width and height of each, pixels."""
    width, height = panel
    font = _font(max(11, round(width / 15)), bold=True)
    small = _font(max(10, round(width / 17)))
    headings = [_wrap(reel.title.replace(", ", ",\n"), font, width) for reel in reels]
    line = font.getbbox("Ag")[3] + 3
    head = round(max(heading.count("\n") + 1 for heading in headings) * line) + 2 * GAP
    # H.264 with 4:2:0 needs even sizes.
    total = (len(reels) * (width + GAP) + GAP) // 2 * 2, (head + height + GAP) // 2 * 2
    sheet = Image.new("RGB", total, PAPER)
    draw = ImageDraw.Draw(sheet)
    for k, (reel, heading) in enumerate(zip(reels, headings, strict=True)):
        x = GAP + k * (width + GAP)
        middle = x + width / 2, head / 2
        draw.multiline_text(middle, heading, INK, font, anchor="mm", align="center", spacing=3)
        if not reel.frames:
            draw.rectangle((x, head, x + width - 1, head + height - 1), BLANK)
            text = _wrap(f"missing:\n{reel.reason}", small, width - 2 * GAP)
            middle = x + width / 2, head + height / 2
            draw.multiline_text(middle, text, INK, small, anchor="mm", align="center", spacing=4)
    frames = []
    for n in range(max((len(reel.frames) for reel in reels), default=0)):
        frame = sheet.copy()
        for k, reel in enumerate(reels):
            if reel.frames:
                image = Image.fromarray(reel.frames[n])
                if image.size != panel:
                    image = image.resize(panel, Image.Resampling.LANCZOS)
                frame.paste(image, (GAP + k * (width + GAP), head))
        frames.append(frame)
    return frames


def film_panel(size: tuple[int, int]) -> tuple[int, int]:
    """Width and height of a panel in the MP4, for images of the given width and height."""
    height = min(max(size[1], FILM_HEIGHTS[0]), FILM_HEIGHTS[1])
    return max(1, round(size[0] * height / size[1])), height


def webp_panel(size: tuple[int, int], count: int) -> tuple[int, int]:
    """Width and height of a panel in the WebP, for ``count`` images of the given size."""
    width = min((WEBP_WIDTH - GAP) // count - GAP, 320)
    return width, max(1, round(width * size[1] / size[0]))


def write_webp(path: Path, frames: Sequence[Image.Image], fps: int) -> None:
    """Write a looping animated WebP, with the best quality that fits into :data:`WEBP_BYTES`."""
    for quality in (85, 75, 65, 50, 35, 20, 5):
        buffer = BytesIO()
        frames[0].save(
            buffer,
            "WEBP",
            save_all=True,
            append_images=list(frames[1:]),
            duration=round(1000 / fps),
            loop=0,
            quality=quality,
            method=4,
        )
        if buffer.tell() <= WEBP_BYTES:
            break
    write_atomically(path, lambda file: file.write_bytes(buffer.getvalue()))


def _wrap(text: str, font: ImageFont.FreeTypeFont, width: float) -> str:
    """The text, wrapped to lines of at most about ``width`` pixels."""
    letters = max(4, int(width / font.getlength("abcdefghij") * 10))
    lines = (textwrap.wrap(line, letters) for line in text.split("\n"))
    return "\n".join(part for parts in lines for part in parts)


def _font(size: int, bold: bool = False) -> ImageFont.FreeTypeFont:
    """The font of the figures, which comes with matplotlib."""
    from matplotlib.font_manager import FontProperties, findfont

    weight = "bold" if bold else "normal"
    return ImageFont.truetype(findfont(FontProperties(family="DejaVu Sans", weight=weight)), size)

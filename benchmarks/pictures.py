"""Pictures side by side, with words above them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw, ImageFont

GAP, HEAD = 4, 18


def side_by_side(shown: Sequence[np.ndarray], words: Sequence[str]) -> Image.Image:
    """Displayed values, (H, W, 3) each, next to each other; ``words`` are above the first ones."""
    height, width = shown[0].shape[:2]
    strip = Image.new("RGB", (len(shown) * (width + GAP) - GAP, height + HEAD), "white")
    draw, font = ImageDraw.Draw(strip), ImageFont.load_default(12)
    for k, picture in enumerate(shown):
        if k < len(words):
            draw.text((k * (width + GAP), 2), words[k], "black", font)
        strip.paste(
            Image.fromarray(np.round(255 * picture).astype(np.uint8)), (k * (width + GAP), HEAD)
        )
    return strip


def stacked(strips: Sequence[Image.Image]) -> Image.Image:
    """Strips below each other."""
    whole = Image.new("RGB", (max(s.width for s in strips), sum(s.height for s in strips)), "white")
    y = 0
    for strip in strips:
        whole.paste(strip, (0, y))
        y += strip.height
    return whole

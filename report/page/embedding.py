"""Figures and tone-mapped images as data URIs."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from io import BytesIO
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image

from gpf.core.errors import UserError
from gpf.core.images import tone_map

if TYPE_CHECKING:
    from report.figures import Figure

LARGE = 250_000
"""Bytes; larger figures are stored as lossy WebP of high quality."""


@dataclass(frozen=True)
class Embedded:
    """An ``<img>``.

    Attributes
    ----------
    source: data URI.
    width, height: pixels; they reserve its place while the page loads.
    inches: intended width; 0 for the full width.
    """

    source: str
    width: int
    height: int
    inches: float = 0.0


def embed_figure(figure: Figure) -> Embedded | None:
    """A figure as SVG if that is small, else as PNG, or as WebP if the PNG is large.

    None for a figure that was left out. An animated PNG is stored as it is.

    Raises
    ------
    UserError: a file cannot be read.
    """
    if figure.svg is None or figure.png is None:
        return None
    try:
        with Image.open(figure.png) as picture:
            width, height = picture.size
            inches = width / picture.info["dpi"][0] if "dpi" in picture.info else 0.0
            moves = getattr(picture, "is_animated", False)
            if not moves and figure.svg.stat().st_size <= LARGE:
                data, kind = figure.svg.read_bytes(), "svg+xml"
            elif moves or figure.png.stat().st_size <= LARGE:
                data, kind = figure.png.read_bytes(), "png"
            else:
                data, kind = _webp(picture), "webp"
    except OSError as error:
        raise UserError(
            str(error.filename or figure.png),
            f"cannot be read as the figure {figure.name} ({error.strerror or error})",
            "Run `gpf stage report` again: it draws all figures.",
        ) from error
    return Embedded(to_uri(data, kind), width, height, inches)


def embed_radiance(radiance: np.ndarray, exposure: float) -> Embedded:
    """An image (H, W, 3), tone-mapped with the exposure of the metrics."""
    pixels = np.round(tone_map(radiance, exposure) * 255).astype(np.uint8)
    picture = Image.fromarray(pixels)
    return Embedded(to_uri(_webp(picture), "webp"), picture.width, picture.height)


def _webp(picture: Image.Image) -> bytes:
    stream = BytesIO()
    picture.convert("RGB").save(stream, "WEBP", quality=90, method=6)
    return stream.getvalue()


def to_uri(data: bytes, kind: str) -> str:
    """A data URI with the bytes of a picture; ``kind`` is its type, like `png`."""
    return f"data:image/{kind};base64,{base64.b64encode(data).decode('ascii')}"

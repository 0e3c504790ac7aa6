"""Radiance in the page: bfloat16, predicted from neighbours, deflated, as base64 text.

bfloat16 is the upper half of a float32. It has the same range and 8 significant bits, so that the
relative error of a stored value is at most 1/256, at any exposure. As in JPEG-LS, the codes of G,
R - G and B - G are predicted by the median of left, above and left + above - corner; the residuals
are deflated. `codec.js` decodes them.
"""

from __future__ import annotations

import base64
import zlib
from dataclasses import dataclass

import numpy as np

from gpf.core.images import check_finite

PRECISION = 1 / 256
"""Largest relative error of a stored value."""

_LARGEST = np.uint32(0x7F7F)  # the next code is infinity


@dataclass(frozen=True)
class Picture:
    """An image: base64 text of the deflated residuals of ``height`` rows of ``width`` pixels."""

    width: int
    height: int
    data: str


def encode(radiance: np.ndarray, where: str) -> Picture:
    """Encode radiance (H, W, 3). Negative radiance becomes 0, as on a screen.

    Raises
    ------
    UserError: NaN or infinite values. ``where`` names the image in the message.
    """
    check_finite(radiance, where)
    height, width, _ = radiance.shape
    residuals = predict(to_codes(radiance))
    octets = residuals.astype("<u2").view(np.uint8)
    # Lower and upper bytes get separate Huffman codes, because nearly all upper bytes are 0. The
    # lower bytes are noise: the default strategy, which searches for repeated strings, takes ten
    # times as long and 4 % more bytes.
    packer = zlib.compressobj(strategy=zlib.Z_RLE)
    packed = packer.compress(octets[0::2].tobytes()) + packer.flush(zlib.Z_BLOCK)
    packed += packer.compress(octets[1::2].tobytes()) + packer.flush()
    return Picture(width, height, base64.b64encode(packed).decode("ascii"))


def to_codes(radiance: np.ndarray) -> np.ndarray:
    """The nearest bfloat16 of each value, as uint16 of the same shape."""
    bits = np.maximum(radiance, 0).astype(np.float32).view(np.uint32)
    rounded = (bits + 0x7FFF + ((bits >> 16) & 1)) >> 16  # ties go to the even neighbour
    return np.minimum(rounded, _LARGEST).astype(np.uint16)


def to_radiance(codes: np.ndarray) -> np.ndarray:
    """The values of codes, float32."""
    return (codes.astype(np.uint32) << 16).view(np.float32)


def predict(codes: np.ndarray) -> np.ndarray:
    """Residuals of the prediction, by plane and row, (3 H W,) uint16, zigzag coded.

    Zigzag coding turns 0, -1, 1, -2, … into 0, 1, 2, 3, …
    """
    red, green, blue = np.moveaxis(codes.astype(np.int32), -1, 0)
    planes = np.stack([green, red - green, blue - green])
    left, above, corner = np.zeros((3, *planes.shape), dtype=np.int32)
    left[:, :, 1:] = planes[:, :, :-1]
    above[:, 1:] = planes[:, :-1]
    corner[:, 1:, 1:] = planes[:, :-1, :-1]
    low, high = np.minimum(left, above), np.maximum(left, above)
    residuals = planes - np.clip(left + above - corner, low, high)
    residuals = residuals.astype(np.int16).astype(np.int32)  # modulo 2^16, as in the decoder
    return ((residuals << 1) ^ (residuals >> 31)).astype(np.uint16).reshape(-1)


def shrink(radiance: np.ndarray, factor: int) -> np.ndarray:
    """Means of ``factor`` × ``factor`` pixels; leftover pixels at the right and bottom are cut."""
    height, width = (side // factor for side in radiance.shape[:2])
    cut = radiance[: height * factor, : width * factor]
    return cut.reshape(height, factor, width, factor, 3).mean(axis=(1, 3))

"""Pictures of the page: decoded values are within the precision of the format."""

from __future__ import annotations

import base64
import zlib

import numpy as np
import pytest

from gpf.core.errors import UserError
from report.page.pictures import PRECISION, encode, shrink, to_codes, to_radiance

SHAPE = (5, 7, 3)


def decode(picture) -> np.ndarray:
    """A simple decoder, pixel by pixel; it does the same as codec.js."""
    width, height = picture.width, picture.height
    count = 3 * width * height
    octets = zlib.decompress(base64.b64decode(picture.data))
    assert len(octets) == 2 * count
    planes = np.zeros((3, height, width), dtype=np.int64)
    for i in range(count):
        plane, y, x = i // (width * height), i // width % height, i % width
        residual = octets[i] | octets[count + i] << 8
        left = planes[plane, y, x - 1] if x else 0
        above = planes[plane, y - 1, x] if y else 0
        corner = planes[plane, y - 1, x - 1] if x and y else 0
        if corner >= max(left, above):  # the median of left, above and the plane through all three
            predicted = min(left, above)
        elif corner <= min(left, above):
            predicted = max(left, above)
        else:
            predicted = left + above - corner
        value = predicted + (residual // 2 if residual % 2 == 0 else -(residual + 1) // 2)
        planes[plane, y, x] = (value + 2**15) % 2**16 - 2**15
    green = planes[0]
    codes = np.stack([green + planes[1], green, green + planes[2]], -1) % 2**16
    return to_radiance(codes.astype(np.uint16))


def image(kind: str) -> np.ndarray:
    rng = np.random.default_rng(11)
    if kind == "wide":  # random magnitudes
        return (10 ** rng.uniform(-30, 30, SHAPE)).astype(np.float32)
    if kind == "extreme":  # the most different codes
        return np.where(rng.random(SHAPE) < 0.5, 0, 3.4e38).astype(np.float32)
    return np.full(SHAPE, 0.3, dtype=np.float32) + np.linspace(0, 1, 7)[None, :, None]


@pytest.mark.parametrize("kind", ["smooth", "wide", "extreme"])
def test_decoded_values_are_within_the_precision(kind):
    radiance = image(kind)
    found = decode(encode(radiance, "here"))
    assert found.shape == SHAPE
    assert np.array_equal(found, to_radiance(to_codes(radiance)))
    limit = float(to_radiance(np.array([0x7F7F], np.uint16))[0])
    np.testing.assert_allclose(found, np.minimum(radiance, limit), rtol=PRECISION, atol=0)


def test_codes_are_the_nearest():
    values = np.array([1.0, 1 + 1 / 128, 1 + 0.4 / 128, 1 + 0.6 / 128, 1 + 1.5 / 128, 0.0, -2.0])
    expected = [1.0, 1 + 1 / 128, 1.0, 1 + 1 / 128, 1 + 2 / 128, 0.0, 0.0]
    assert to_radiance(to_codes(values.astype(np.float32))).tolist() == expected


def test_smooth_pictures_get_small():
    smooth = np.tile(np.linspace(0.1, 0.9, 64, dtype=np.float32)[None, :, None], (48, 1, 3))
    assert len(encode(smooth, "here").data) < smooth.size / 8
    noise = np.random.default_rng(1).random((48, 64, 3)).astype(np.float32)
    assert len(encode(noise, "here").data) < 2 * noise.size


def test_values_that_are_not_finite_are_an_error():
    broken = image("smooth")
    broken[2, 3, 1] = np.nan
    with pytest.raises(UserError, match=r"a/b\.exr.*NaN or infinite.*x=3, y=2"):
        encode(broken, "a/b.exr")


def test_shrinking_takes_means_and_cuts_the_rest():
    small = shrink(np.arange(5 * 7 * 3, dtype=float).reshape(SHAPE), 2)
    assert small.shape == (2, 3, 3)
    assert small[1, 2, 0] == np.mean([54, 57, 75, 78])  # rows 2 and 3, columns 4 and 5

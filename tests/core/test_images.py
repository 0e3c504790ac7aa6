"""EXRs keep layers and record; bad ones are refused in words; tone mapping is sRGB's."""

import json
import resource
import time
from contextlib import contextmanager
from functools import partial

import mitsuba as mi
import numpy as np
import OpenEXR
import pytest

from gpf.core.errors import FileError, UserError
from gpf.core.files import SCHEMA_VERSION
from gpf.core.images import (
    check_finite,
    read_exr,
    read_record,
    tone_map,
    tone_secant,
    tone_slope,
    write_exr,
    write_png,
)

HEIGHT, WIDTH = 6, 8
RECORD = {"passes": 4, "view": {"name": "front", "fov": 39.3}, "size": [8, 6]}


def make_layers() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(1)
    return {
        "radiance": rng.uniform(0, 1e4, (HEIGHT, WIDTH, 3)),
        "normal": rng.normal(size=(HEIGHT, WIDTH, 3)).astype(np.float32),
        "sppm_3": rng.uniform(0, 1e-6, (HEIGHT, WIDTH, 3)).astype(np.float32),
        "valid": (rng.random((HEIGHT, WIDTH)) < 0.5).astype(np.float32),
    }


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "reference" / "front.exr"
    write_exr(path, make_layers(), RECORD)
    return path


def test_layers_and_record_come_back(file):
    layers, record = read_exr(file)
    expected = make_layers()
    assert layers.keys() == expected.keys()
    for name, value in expected.items():
        assert layers[name].dtype == np.float32
        np.testing.assert_array_equal(layers[name], value.astype(np.float32), err_msg=name)
    assert record == {**RECORD, "schema_version": SCHEMA_VERSION}
    assert read_record(file) == record
    assert [p.name for p in file.parent.iterdir()] == ["front.exr"]


def test_infinite_values_come_back(tmp_path):
    coverage = np.full((HEIGHT, WIDTH), np.inf, np.float32)
    write_exr(tmp_path / "a.exr", {"coverage": coverage}, {})
    np.testing.assert_array_equal(read_exr(tmp_path / "a.exr")[0]["coverage"], coverage)


def test_other_programs_read_the_radiance(file, two_threads):
    image = np.array(mi.Bitmap(str(file)).split()[0][1].convert(mi.Bitmap.PixelFormat.RGB))
    assert image.shape == (HEIGHT, WIDTH, 3)
    np.testing.assert_array_equal(image, make_layers()["radiance"].astype(np.float32))


def test_the_same_image_is_the_same_file(file, tmp_path):
    time.sleep(1.1)  # a date in the header would differ by now
    write_exr(tmp_path / "again.exr", make_layers(), RECORD)
    assert (tmp_path / "again.exr").read_bytes() == file.read_bytes()


def test_a_missing_image(tmp_path):
    path = tmp_path / "gone.exr"
    assert read_record(path) is None
    with pytest.raises(FileError, match=r"gone\.exr: is missing\. Check the path"):
        read_exr(path)


@pytest.mark.parametrize("share", [*np.arange(10) / 10, 0.999])
def test_a_truncated_image(file, share, capfd):
    data = file.read_bytes()
    file.write_bytes(data[: int(len(data) * share)])
    with pytest.raises(
        FileError,
        match=r"front\.exr: is truncated or not an EXR \(.*\)\. Delete it and make it again",
    ):
        read_exr(file)


def test_something_else_entirely(tmp_path):
    path = tmp_path / "a.exr"
    path.write_text("not an image")
    assert read_record(path) is None
    with pytest.raises(FileError, match="is truncated or not an EXR"):
        read_exr(path)


def test_another_schema_version(tmp_path):
    path = tmp_path / "a.exr"
    header = {"gpf": json.dumps({"schema_version": 99})}
    OpenEXR.File(header, {"R": np.zeros((2, 3), np.float32)}).write(str(path))
    with pytest.raises(
        FileError, match=rf"has schema version 99; this program reads {SCHEMA_VERSION}\. Delete it"
    ):
        read_exr(path)


def test_an_image_of_another_program(tmp_path, two_threads):
    path = tmp_path / "a.exr"
    mi.Bitmap(np.zeros((2, 3, 3), np.float32)).write(str(path))
    with pytest.raises(FileError, match="has schema version none; this program reads"):
        read_exr(path)


# --- NaN --------------------------------------------------------------------------------------


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_broken_pixels_are_counted_and_located(bad):
    image = np.ones((HEIGHT, WIDTH, 3))
    image[2, 5, 1] = image[4, 0, :] = bad
    with pytest.raises(
        UserError,
        match=r"box, view front: 2 of 48 pixels are NaN or infinite, the first at x=5, y=2\. Look",
    ):
        check_finite(image, "box, view front")


def test_a_whole_image_passes():
    check_finite(np.ones((HEIGHT, WIDTH, 3)), "box")


# --- tone mapping -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("linear", "shown"),
    [
        (0, 0),
        (0.001, 0.01292),
        (0.0031308, 0.04045),
        (0.18, 0.461356),
        (0.2140411, 0.5),
        (0.5, 0.735357),
        (1, 1),
        (7, 1),
        (-0.5, 0),
    ],
)
def test_linear_values_become_srgb_and_are_clamped(linear, shown):
    assert tone_map(np.array(linear), 1.0) == pytest.approx(shown, abs=2e-6)


def test_exposure_comes_before_the_clamp():
    np.testing.assert_allclose(tone_map(np.array([0.09, 0.6]), 2.0), [0.461356, 1], atol=2e-6)


def test_a_preview_shows_the_tone_mapped_image(tmp_path):
    radiance = np.zeros((HEIGHT, WIDTH, 3))
    radiance[1, 6] = [0.09, 0.25, 5]
    write_png(tmp_path / "a.png", radiance, 2.0)
    pixels = np.array(mi.Bitmap(str(tmp_path / "a.png")))
    assert pixels.shape == (HEIGHT, WIDTH, 3) and pixels.dtype == np.uint8
    assert pixels[1, 6].tolist() == [118, 188, 255]
    assert np.count_nonzero(pixels) == 3


@contextmanager
def full_disk(room: int):
    """Files can't grow beyond ``room`` bytes."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("name", ["noise.exr", "noise.png"])
def test_a_full_disk_leaves_the_old_image(tmp_path, name):
    """The libraries that write images don't say so with an OSError."""
    noise = np.random.default_rng(1).random((96, 128, 3)).astype(np.float32)
    path = tmp_path / name

    def write(image):
        if path.suffix == ".exr":
            write_exr(path, {"radiance": image}, {})
        else:
            write_png(path, image, 1.0)

    write(noise[:4, :4])
    before = path.read_bytes()
    with full_disk(8192), pytest.raises(UserError, match=f"{name}: could not be written.*Free"):
        write(noise)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("name", ["noise.exr", "noise.png"])
def test_a_disk_that_is_full_before_the_last_byte(tmp_path, name):
    """The libraries keep the end of a file back, and close it without a word."""
    noise = np.random.default_rng(1).random((8, 6, 3)).astype(np.float32)
    path = tmp_path / name
    write = partial(write_exr, path, {"radiance": noise}, {})
    if path.suffix == ".png":
        write = partial(write_png, path, noise, 1.0)
    write()
    size = path.stat().st_size
    path.unlink()
    for room in (0, 1, size // 2, size - 1):
        with full_disk(room), pytest.raises(UserError, match="could not be written.*Free"):
            write()
    assert list(tmp_path.iterdir()) == []
    with full_disk(size):
        write()


def test_a_flipped_bit_is_noticed_or_changes_nothing(file, capfd):
    data, before = file.read_bytes(), read_exr(file)
    for bit in range(0, 8 * len(data), 61):
        flipped = bytearray(data)
        flipped[bit // 8] ^= 1 << (bit % 8)
        file.write_bytes(flipped)
        try:
            layers, record = read_exr(file)
        except FileError:
            continue
        assert record == before[1] and layers.keys() == before[0].keys(), bit
        for name, value in before[0].items():
            np.testing.assert_array_equal(layers[name], value, err_msg=f"bit {bit}")


def test_a_layer_that_an_image_does_not_have(file, tmp_path):
    layers, _ = read_exr(file)
    assert "irradiance" not in layers
    with pytest.raises(FileError, match=r"front\.exr: has no layer irradiance\. Delete it"):
        layers["irradiance"]
    path = tmp_path / "red.exr"
    pixels = np.zeros((HEIGHT, WIDTH), np.float32)
    header = {"gpf": json.dumps({"schema_version": SCHEMA_VERSION})}
    OpenEXR.File(header, {"R": pixels, "B": pixels}).write(str(path))
    with pytest.raises(FileError, match=r"red\.exr: has no channel G"):
        read_exr(path)


def test_beyond_white_all_light_looks_the_same():
    x, y = np.array([0.4, 0.5, 2.0, 0.3]), np.array([10.0, 0.5, 3.0, 0.31])
    found = tone_secant(x, y, 1.0)
    assert found[0] == pytest.approx((1 - tone_map(x[0], 1.0)) / 9.6)
    assert found[1] == pytest.approx(tone_slope(x[1], 1.0)) and found[2] == 0
    assert found[3] == pytest.approx(tone_slope(np.array(0.305), 1.0), rel=1e-3)

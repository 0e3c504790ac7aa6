"""Panels side by side: where they are, what they show, and equal files."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from stages.animation import filmstrip
from stages.animation.filmstrip import BLANK, GAP, Reel, compose, film_panel, webp_panel

RED, BLUE = (200, 30, 30), (20, 40, 220)
PANEL = 120, 80


def flat(colour: tuple[int, int, int]) -> np.ndarray:
    return np.full((8, 12, 3), colour, np.uint8)


@pytest.fixture
def frames() -> list[Image.Image]:
    moving = [flat(RED), flat(BLUE), flat(RED)]
    return compose(
        [
            Reel("Path tracer + OIDN, equal time", moving),
            Reel("Splats", [], "10 training views with images are needed, but only 3 exist"),
            Reel("GPF, 64 spp", [flat(BLUE)] * 3),
        ],
        PANEL,
    )


def panel(frame: Image.Image, number: int) -> np.ndarray:
    """Pixels of a panel; panels end a gap above the lower edge."""
    pixels = np.asarray(frame)
    x, y = GAP + number * (PANEL[0] + GAP), frame.height - GAP - PANEL[1]
    return pixels[y : y + PANEL[1], x : x + PANEL[0]]


def test_panels_lie_side_by_side_under_their_titles(frames):
    assert len(frames) == 3
    assert frames[0].width == 3 * PANEL[0] + 4 * GAP and frames[0].height % 2 == 0
    assert (panel(frames[0], 0) == RED).all() and (panel(frames[1], 0) == BLUE).all()
    assert all((panel(frame, 2) == BLUE).all() for frame in frames)
    head = np.asarray(frames[0])[: frames[0].height - GAP - PANEL[1]]
    for number in range(3):
        x = GAP + number * (PANEL[0] + GAP)
        assert (head[:, x : x + PANEL[0]].max(axis=-1) < 80).any(), number
    # Titles keep off the edges and off each other.
    columns = np.flatnonzero((head.max(axis=-1) < 128).any(axis=0))
    rows = np.flatnonzero((head.max(axis=-1) < 128).any(axis=1))
    gaps = [GAP + k * (PANEL[0] + GAP) - GAP // 2 for k in range(4)]
    assert not set(gaps) & set(columns.tolist()) and rows.min() > 1 and rows.max() < len(head) - 1


def test_what_is_missing_says_why(frames):
    missing = panel(frames[0], 1)
    assert (missing[2, 2] == BLANK).all() and (missing[-3, -3] == BLANK).all()
    inked = np.flatnonzero((missing.max(axis=-1) < 100).any(axis=0))
    assert inked.min() > 2 and inked.max() < PANEL[0] - 3


def test_a_picture_that_moves_repeats_and_fits(frames, tmp_path, monkeypatch):
    path = tmp_path / "moving.webp"
    filmstrip.write_webp(path, frames, 10)
    with Image.open(path) as picture:
        assert picture.n_frames == 3 and picture.info["loop"] == 0
        picture.seek(1)
        picture.load()
        assert picture.info["duration"] == 100
        shown = panel(picture.convert("RGB"), 0)
    assert np.abs(shown.astype(int) - BLUE).max() < 25
    filmstrip.write_webp(tmp_path / "again.webp", frames, 10)
    assert (tmp_path / "again.webp").read_bytes() == path.read_bytes()
    noise = np.random.default_rng(1).integers(0, 256, (3, 100, 200, 3), dtype=np.uint8)
    noisy = [Image.fromarray(image) for image in noise]
    filmstrip.write_webp(path, noisy, 10)
    best = path.stat().st_size
    monkeypatch.setattr(filmstrip, "WEBP_BYTES", best // 2)
    filmstrip.write_webp(path, noisy, 10)
    assert path.stat().st_size <= best // 2


def test_sizes_of_panels():
    assert film_panel((20, 16)) == (320, 256) and film_panel((1280, 720)) == (683, 384)
    width, height = webp_panel((256, 256), 5)
    assert width == height and 5 * (width + GAP) + GAP <= filmstrip.WEBP_WIDTH

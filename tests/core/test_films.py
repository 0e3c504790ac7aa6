"""Films: what they show, equal files, and an encoder that fails."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from imageio_ffmpeg import get_ffmpeg_exe

from gpf.core.errors import UserError
from gpf.core.films import write_film

RED, BLUE = (200, 30, 30), (20, 40, 220)


@pytest.fixture(params=[(80, 120), (81, 119)], ids=str)
def frames(request) -> list[np.ndarray]:
    return [np.full((*request.param, 3), colour, np.uint8) for colour in (RED, BLUE, RED)]


def test_a_film_shows_the_frames_and_has_no_date(frames, tmp_path):
    path = tmp_path / "film.mp4"
    write_film(path, frames, 12)
    command = [get_ffmpeg_exe(), "-loglevel", "error", "-i", str(path), "-f", "rawvideo"]
    raw = subprocess.run([*command, "-pix_fmt", "rgb24", "-"], capture_output=True, check=True)
    height, width = (n + n % 2 for n in frames[0].shape[:2])
    shown = np.frombuffer(raw.stdout, np.uint8).reshape(len(frames), height, width, 3)
    for picture, frame in zip(shown, frames, strict=True):
        assert np.abs(picture[20:60, 20:100].astype(int) - frame[0, 0]).max() < 30
    write_film(tmp_path / "again.mp4", frames, 12)
    assert (tmp_path / "again.mp4").read_bytes() == path.read_bytes()


def test_without_the_encoder_it_is_said_what_brings_it(frames, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(UserError, match="pip install imageio-ffmpeg"):
        write_film(tmp_path / "film.mp4", frames, 12)
    assert not (tmp_path / "film.mp4").exists()


def test_an_encoder_that_fails_is_told_in_its_own_words(frames, tmp_path, monkeypatch):
    program = tmp_path / "encoder"
    program.write_text("#!/bin/sh\ncat > /dev/null\necho 'no room for x264' >&2\nexit 3\n")
    program.chmod(0o755)
    monkeypatch.setattr("imageio_ffmpeg.get_ffmpeg_exe", lambda: str(program))
    with pytest.raises(
        UserError, match=r"film\.mp4: could not be encoded: no room for x264\. .*pip"
    ):
        write_film(tmp_path / "film.mp4", frames, 12)
    assert [path.name for path in tmp_path.iterdir()] == ["encoder"]

    def find_none():
        raise RuntimeError("No ffmpeg exe could be found")

    monkeypatch.setattr("imageio_ffmpeg.get_ffmpeg_exe", find_none)
    with pytest.raises(UserError, match="has no encoder: No ffmpeg exe"):
        write_film(tmp_path / "film.mp4", frames, 12)

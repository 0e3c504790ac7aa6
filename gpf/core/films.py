"""Films: H.264 in MP4 files, which all browsers play."""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Iterable
from contextlib import suppress
from itertools import chain
from pathlib import Path

import numpy as np

from gpf.core.errors import UserError
from gpf.core.files import write_atomically

_REINSTALL = (
    "Check the free disk space; `pip install --force-reinstall imageio-ffmpeg` reinstalls the "
    "encoder."
)


def write_film(path: Path, frames: Iterable[np.ndarray], fps: int) -> None:
    """Write an MP4 with 4:2:0 colour; the same frames give the same bytes.

    Parameters
    ----------
    frames: at least one, 8-bit sRGB, (H, W, 3) each; if H or W is odd, a black line is added. With
        a generator, only one frame is in memory at a time.

    Raises
    ------
    UserError: the package with the encoder is missing, or the encoder failed.
    """
    frames = iter(frames)
    first = next(frames, None)
    if first is None:
        raise UserError(str(path), "would have no frames", "Render a picture first.")
    height, width = first.shape[:2]
    command = [find_encoder(), "-y", "-loglevel", "error"]
    command += ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", f"{fps}"]
    command += ["-i", "-", "-c:v", "libx264", "-preset", "slow", "-crf", "20"]
    if width % 2 or height % 2:
        command += ["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2"]
    # One thread and no dates, so that the file depends only on the frames.
    command += ["-pix_fmt", "yuv420p", "-threads", "1", "-map_metadata", "-1"]
    command += ["-fflags", "+bitexact", "-flags:v", "+bitexact", "-movflags", "+faststart"]

    def encode(file: Path) -> None:
        with tempfile.TemporaryFile() as errors:
            run = subprocess.Popen([*command, str(file)], stdin=subprocess.PIPE, stderr=errors)
            assert run.stdin is not None
            try:
                for frame in chain([first], frames):
                    # A broken pipe means that the encoder has ended; its message is read below.
                    with suppress(BrokenPipeError):
                        run.stdin.write(np.ascontiguousarray(frame, np.uint8).tobytes())
                with suppress(BrokenPipeError):
                    run.stdin.close()
            except BaseException:
                run.kill()
                run.wait()
                raise
            if run.wait():
                errors.seek(0)
                said = errors.read().decode(errors="replace").strip()[-300:]
                said = said or f"status {run.returncode}"
                raise UserError(str(path), f"could not be encoded: {said}", _REINSTALL)

    write_atomically(path, encode)


def find_encoder() -> str:
    """The path of the encoder in the package imageio-ffmpeg.

    Raises
    ------
    UserError: the package or the encoder is missing.
    """
    try:
        from imageio_ffmpeg import get_ffmpeg_exe

        return str(get_ffmpeg_exe())
    except ImportError as error:
        raise UserError(
            "imageio_ffmpeg",
            "is not installed, so no MP4 can be written",
            "Run `pip install imageio-ffmpeg`.",
        ) from error
    except RuntimeError as error:
        raise UserError("imageio_ffmpeg", f"has no encoder: {error}", _REINSTALL) from error

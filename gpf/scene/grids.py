"""Find grids of media that are too large before Mitsuba reads them."""

from __future__ import annotations

import struct
from pathlib import Path

from gpf.core.machine import require_memory

# Mitsuba's format: "VOL", the version, the encoding, the number of values along x, y and z, and
# the number of channels.
_HEADER = struct.Struct("<3sB5i")

_COPIES = 2
"""Mitsuba holds the values of the file and those of its texture at once."""


def check_grid(file: Path, where: str) -> None:
    """Raise a :class:`UserError` if a grid (``.vol``) needs more memory than there is. Files of
    other kinds are skipped, and Mitsuba itself reports all other errors.

    ``where``: place in the scene file that names the grid, for the message.
    """
    if file.suffix.lower() != ".vol":
        return
    with file.open("rb") as stream:
        head = stream.read(_HEADER.size)
    if len(head) < _HEADER.size or head[:3] != b"VOL":
        return
    _, _, _, x, y, z, channels = _HEADER.unpack(head)
    size = f"{file.name}, a grid of {x} x {y} x {z} values with {channels} channels"
    require_memory(where, size, 4.0 * _COPIES * x * y * z * channels)

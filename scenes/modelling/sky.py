"""Generated skies for Mitsuba's ``envmap``."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gpf.modelling.textures import ramp

Stops = list[tuple[float, tuple[float, float, float]]]


def write_sky(path: Path, stops: Stops, rows: int = 32) -> Path:
    """Write a sky that depends on the elevation only, as a latitude-longitude map; return ``path``.

    ``stops`` are pairs (sine of the elevation, radiance), from -1 at the nadir to 1 at the zenith,
    with linear interpolation (:func:`gpf.modelling.textures.ramp`). The map has ``rows`` rows of
    2 ``rows`` pixels, the zenith in the first row. It is a PFM, so radiance is not clamped.
    """
    elevation = np.pi * (0.5 - (np.arange(rows) + 0.5) / rows)
    pixels = np.broadcast_to(ramp(np.sin(elevation), stops)[:, None], (rows, 2 * rows, 3))
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as file:
        file.write(f"PF\n{2 * rows} {rows}\n-1.0\n".encode("ascii"))  # -1: little endian
        # The file begins with the lowest row. Six decimals are the same on every machine.
        file.write(np.round(pixels[::-1], 6).astype("<f4").tobytes())
    return path

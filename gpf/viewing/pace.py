"""The size of pictures of a moving camera."""

from __future__ import annotations

HEIGHTS = (192, 224, 256, 320, 384, 448, 512)
"""Rows of pictures of a moving camera."""

FRAME_SECONDS = 0.035
"""Time for such a picture; the largest height that fits into it is chosen."""


class Pace:
    """Chooses the height of pictures of a moving camera from the time that earlier ones took."""

    def __init__(self) -> None:
        self.per_pixel: float | None = None
        self._height = HEIGHTS[0]

    def note(self, seconds: float, pixels: int) -> None:
        """Record how long a picture took."""
        found = seconds / pixels
        self.per_pixel = found if self.per_pixel is None else 0.8 * self.per_pixel + 0.2 * found

    def height(self, aspect: float, most: int) -> int:
        """The largest of :data:`HEIGHTS` that fits into :data:`FRAME_SECONDS`."""
        if self.per_pixel is not None:
            for height in HEIGHTS:
                spent = self.per_pixel * aspect * height * height
                # The picture grows only with time to spare.
                most_time = FRAME_SECONDS * (0.8 if height > self._height else 1.1)
                if height == HEIGHTS[0] or spent < most_time:
                    best = height
            self._height = best
        return min(self._height, most)

"""What an open page looks at, and its picture so far."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from gpf.importing.orbit import unit_vector
from gpf.scene.views import Keyframe
from gpf.viewing.messages import Look
from gpf.viewing.screen import Accumulated
from gpf.viewing.server import Client


@dataclass
class Shown:
    """An open page: what it looks at, and its picture so far."""

    client: Client
    camera: Keyframe
    look: Look = field(default_factory=Look)
    number: int = 0
    moved: float = 0.0
    moving: bool = True
    picture: Accumulated = field(default_factory=Accumulated)
    compared: Accumulated = field(default_factory=Accumulated)
    seconds: float = 0.0
    compared_seconds: float = 0.0
    sent: float = 0.0
    denoised: np.ndarray | None = None
    tasks: deque[Iterator[None]] = field(default_factory=deque)

    def has_moved(self) -> bool:
        """Whether the page asks for another picture; a server thread may set this at any time."""
        return self.moving

    def start_anew(self) -> None:
        """Forget the picture."""
        self.picture, self.compared = Accumulated(), Accumulated()
        self.seconds = self.compared_seconds = 0.0
        self.denoised = None


def same_place(one: Keyframe, other: Keyframe) -> bool:
    """Whether two cameras make the same picture."""
    ahead = [np.subtract(camera.target, camera.origin) for camera in (one, other)]
    first, second = (unit_vector(way) for way in ahead)
    return (
        np.allclose(one.origin, other.origin, atol=1e-5)
        and np.allclose(first, second, atol=1e-5)
        and abs(one.fov - other.fov) < 1e-3
    )

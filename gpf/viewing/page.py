"""What an open page looks at, its picture so far, and the files that it waits for."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from gpf.core.errors import UserError
from gpf.scene.views import Keyframe
from gpf.viewing.messages import Look
from gpf.viewing.screen import Accumulated
from gpf.viewing.server import Client


@dataclass
class Page:
    """An open page.

    Attributes
    ----------
    number: of the newest message that changes the picture.
    moved: when the camera moved last, by ``time.perf_counter``.
    moving: whether the page asks for another picture.
    compared: the picture by path tracing, beside that of the field.
    gathered: two pictures by gathered light, (2, H, W, 3), which correct that of the field.
    depth: distance of what the picture shows (:meth:`gpf.viewing.screen.Screen.depth`); None while
        it is not known.
    sent: when the last picture was sent.
    tasks: files to be made; each step of an iterator is one frame at most, so that cameras keep
        moving.
    """

    client: Client
    camera: Keyframe
    look: Look = field(default_factory=Look)
    number: int = 0
    moved: float = 0.0
    moving: bool = True
    picture: Accumulated = field(default_factory=Accumulated)
    compared: Accumulated = field(default_factory=Accumulated)
    gathered: Accumulated = field(default_factory=Accumulated)
    depth: float | None = None
    sent: float = 0.0
    denoised: np.ndarray | None = None
    tasks: deque[Iterator[None]] = field(default_factory=deque)

    def has_moved(self) -> bool:
        """Whether the page asks for another picture; a server thread may set this at any time."""
        return self.moving

    def start_anew(self) -> None:
        """Forget the picture."""
        self.picture, self.compared, self.gathered = Accumulated(), Accumulated(), Accumulated()
        self.denoised = self.depth = None

    def do_task(self) -> bool:
        """Take one step of the first task; return whether there was one."""
        if not self.tasks:
            return False
        try:
            next(self.tasks[0])
        except StopIteration:
            self.tasks.popleft()
        except UserError as error:
            self.tasks.popleft()
            self.client.tell({"type": "error", "text": str(error)})
        return True

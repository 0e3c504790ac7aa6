"""The page's listening socket, which limits the connections that have not sent the token."""

from __future__ import annotations

import socket
import threading
import time
from contextlib import suppress
from typing import Any

# Seconds within which a connection that is shut down has to be gone.
_PATIENCE = 1.0


class Door(socket.socket):
    """A listening socket with a limit on strangers: connections for which :meth:`trust` was not
    called.

    When there are too many, the one that has waited longest is closed before the next is accepted.
    A page sends the token in its first packet, so it gets through a crowd that sends nothing.

    Parameters
    ----------
    most: largest number of strangers; each takes two threads of the server.
    """

    def __init__(self, host: str, port: int, most: int) -> None:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        both = host == "::"
        door = socket.create_server((host, port), family=family, dualstack_ipv6=both)
        super().__init__(fileno=door.detach())
        self._most = most
        self._strangers: list[socket.socket] = []
        self._lock = threading.Lock()

    def accept(self) -> tuple[socket.socket, Any]:
        """The next connection; called from one thread of the server."""
        link, address = super().accept()
        while not self._makes_room():
            link.close()
            link, address = super().accept()
        self._strangers.append(link)
        return link, address

    def trust(self, link: socket.socket) -> None:
        """Stop counting a connection that has sent the token; it is never closed to make room."""
        with self._lock, suppress(ValueError):
            self._strangers.remove(link)

    def _makes_room(self) -> bool:
        """Make room for one more stranger; return whether there is."""
        if self._has_room():
            return True
        with self._lock, suppress(OSError, IndexError):
            self._strangers[0].shutdown(socket.SHUT_RDWR)  # wakes the threads that wait for it
        end = time.monotonic() + _PATIENCE
        while not self._has_room():
            if time.monotonic() > end:
                return False
            time.sleep(0.001)
        return True

    def _has_room(self) -> bool:
        with self._lock:
            # Closing a connection is the last thing that the server does with it.
            self._strangers = [link for link in self._strangers if link.fileno() >= 0]
            return len(self._strangers) < self._most

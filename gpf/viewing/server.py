"""A server for one page and its websocket, on this machine alone.

The page's address contains a random token; a request without it gets nothing. The websocket is
refused to pages of other origins. No file is ever read for a request: the page is in memory.
Connections that do not send the token are few and short-lived (:mod:`gpf.viewing.door`).
"""

from __future__ import annotations

import errno
import hmac
import logging
import secrets
import socket
import threading
from pathlib import Path
from typing import Protocol

from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.sync.server import Server, ServerConnection, serve

from gpf.core.errors import UserError
from gpf.viewing.door import Door
from gpf.viewing.messages import MOST_BYTES, Message, Seen, pack, read_message

PAGE = Path(__file__).with_name("page.html")

# Pictures that are sent before the page confirms that it has shown one.
IN_FLIGHT = 2

# A page that sends more invalid messages than this is disconnected.
MOST_MISTAKES = 20

# Connections that have not sent the token, and the time that they have to send it.
MOST_STRANGERS, HANDSHAKE_SECONDS = 32, 5.0

_EVERYWHERE, _LOOPBACK = ("", "0.0.0.0", "::"), ("127.0.0.1", "localhost", "::1")

# The page loads nothing from elsewhere, and no other page may show it in a frame.
_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "img-src blob: data:; connect-src 'self'; frame-ancestors 'none'"
)

log = logging.getLogger(__name__)

# Messages that report progress.
_STATES = ("status", "film")


class Client:
    """An open page, and the messages that wait to be sent to it.

    Only the newest picture waits; a slow page misses the others. Other messages wait in order; one
    that reports progress replaces the one before it.
    """

    def __init__(self, connection: ServerConnection) -> None:
        self._connection = connection
        self._ready = threading.Condition()
        self._picture: bytes | None = None
        self._others: list[tuple[object, bytes]] = []
        self._sent, self._seen = 0, 0
        self._closed = False

    @property
    def waits(self) -> bool:
        """Whether the page is ready for another picture, and none is waiting."""
        return self._picture is None and self._sent - self._seen < IN_FLIGHT

    def show(self, header: dict[str, object], picture: bytes) -> None:
        """Send a picture; it replaces one that has not been sent yet."""
        with self._ready:
            number = self._sent + 1
            self._picture = pack({"type": "picture", "picture": number, **header}, picture)
            self._ready.notify()

    def tell(self, header: dict[str, object], data: bytes = b"") -> None:
        """Send another message."""
        with self._ready:
            kind = header["type"]
            if self._others and self._others[-1][0] == kind and kind in _STATES:
                self._others.pop()
            self._others.append((kind, pack(header, data)))
            self._ready.notify()

    def note_seen(self, picture: int) -> None:
        """The page has shown a picture."""
        with self._ready:
            self._seen = min(max(self._seen, picture), self._sent)
            self._ready.notify()

    def close(self) -> None:
        """End the sending thread."""
        with self._ready:
            self._closed = True
            self._ready.notify()

    def send_all(self) -> None:
        """Send until the page is closed; runs in a thread of its own."""
        try:
            while (message := self._next()) is not None:
                self._connection.send(message)
        except (ConnectionClosed, OSError):
            pass  # the receiving thread ends the client

    def _next(self) -> bytes | None:
        with self._ready:
            while not self._closed:
                if self._others:
                    return self._others.pop(0)[1]
                if self._picture is not None and self._sent - self._seen < IN_FLIGHT:
                    picture, self._picture = self._picture, None
                    self._sent += 1
                    return picture
                self._ready.wait()
        return None


class Listener(Protocol):
    """Is told what happens to pages; called from threads of the server."""

    def opened(self, client: Client) -> None:
        """A page was opened."""

    def received(self, client: Client, message: Message) -> None:
        """A page has sent a message."""

    def closed(self, client: Client) -> None:
        """A page was closed."""


class PageServer:
    """Serves the page until it is closed.

    Parameters
    ----------
    port: 0 for any free port.

    Raises
    ------
    UserError: the host or the port cannot be used.
    """

    def __init__(self, listener: Listener, host: str = "127.0.0.1", port: int = 0) -> None:
        self.token = secrets.token_urlsafe(16)
        self._listener = listener
        self._page = PAGE.read_bytes()
        try:
            self._door = Door(host, port, MOST_STRANGERS)
            self._server: Server = serve(
                self._talk,
                sock=self._door,
                process_request=self._answer,
                open_timeout=HANDSHAKE_SECONDS,
                compression=None,
                max_size=MOST_BYTES,
                server_header=None,
                close_timeout=0.5,
                logger=_quiet(),
            )
        except (OSError, OverflowError) as error:
            where, todo = f"--host {host}", "Give an address of this machine."
            if getattr(error, "errno", None) in (None, errno.EADDRINUSE, errno.EACCES):
                where, todo = f"--port {port}", "Choose another, or 0 for any."
            raise UserError(where, f"cannot be used: {error}", todo) from error
        self.port = int(self._server.socket.getsockname()[1])
        self.host = host
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()

    @property
    def address(self) -> str:
        """The page's address."""
        return f"http://{self._name}/{self.token}/"

    @property
    def _name(self) -> str:
        host = socket.gethostname() if self.host in _EVERYWHERE else self.host
        return f"{f'[{host}]' if ':' in host else host}:{self.port}"

    def _is_ours(self, name: str | None) -> bool:
        """Whether a request may call this machine by this name, at any port: that of a tunnel is
        another.

        A page from elsewhere whose host name resolves to this machine sends that name. If other
        machines are meant to reach this one, it may have any name; then only the token protects it.
        """
        host = (name or "").rpartition(":")[0].strip("[]") or name
        return host in _LOOPBACK or (name is not None and self.host not in _LOOPBACK)

    def close(self) -> None:
        """Close all pages and the port."""
        # The library waits for connections in the middle of a handshake or a large file.
        threading.Thread(target=self._server.shutdown, daemon=True).start()
        self._thread.join(0.4)

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """The page, a refusal, or None to open the websocket."""
        name = request.headers.get("Host")
        if not self._is_ours(name):
            return connection.respond(403, "Wrong host.\n")
        token, _, rest = request.path.removeprefix("/").partition("/")
        if not hmac.compare_digest(token.encode(), self.token.encode()):
            return connection.respond(403, "Wrong address: use the one that `gpf view` prints.\n")
        if rest == "":
            headers = {
                "Content-Type": "text/html; charset=utf-8",
                "Content-Length": str(len(self._page)),
                "Content-Security-Policy": _POLICY,
                "Cache-Control": "no-store",
                "Referrer-Policy": "no-referrer",
                "X-Content-Type-Options": "nosniff",
            }
            return Response(200, "OK", Headers(headers), self._page)
        if rest != "socket":
            return connection.respond(404, "There is only one page.\n")
        if request.headers.get("Origin") != f"http://{name}":
            return connection.respond(403, "Wrong origin.\n")
        return None

    def _talk(self, connection: ServerConnection) -> None:
        """Receive the messages of a page until it is closed."""
        self._door.trust(connection.socket)
        client = Client(connection)
        sender = threading.Thread(target=client.send_all, daemon=True)
        sender.start()
        self._listener.opened(client)
        mistakes = 0
        try:
            for text in connection:
                try:
                    message = read_message(text)
                except UserError as error:
                    mistakes += 1
                    if mistakes > MOST_MISTAKES:
                        connection.close(1008, "too many invalid messages")
                        break
                    client.tell({"type": "error", "text": str(error)})
                    continue
                if isinstance(message, Seen):
                    client.note_seen(message.picture)
                self._listener.received(client, message)
        except ConnectionClosed:
            pass
        finally:
            client.close()
            self._listener.closed(client)


def _quiet() -> logging.Logger:
    """A silent logger for the library: refused requests are of no interest to the user."""
    quiet = logging.getLogger(f"{__name__}.websockets")
    quiet.setLevel(logging.CRITICAL)
    return quiet

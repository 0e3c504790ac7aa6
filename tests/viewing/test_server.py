"""The server of the page: what it serves, and what it refuses."""

from __future__ import annotations

import json
import socket
import struct
import time
from contextlib import contextmanager

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from gpf.core.errors import UserError
from gpf.viewing.messages import MOST_BYTES, Camera, Look, read_message
from gpf.viewing.server import MOST_MISTAKES, Client, PageServer

CAMERA = {"origin": [0, 0, 1], "target": [0, 0, 0], "up": [0, 1, 0], "fov": 40}


class Ear:
    """Remembers what the server tells it."""

    def __init__(self):
        self.clients, self.messages, self.left = [], [], 0

    def opened(self, client):
        self.clients.append(client)

    def received(self, client, message):
        self.messages.append(message)

    def closed(self, client):
        self.left += 1


@pytest.fixture
def ear():
    return Ear()


@pytest.fixture
def server(ear):
    server = PageServer(ear)
    yield server
    server.close()


def ask(server, path, host=None, method="GET", extra=""):
    """The status and the body of an HTTP request."""
    with socket.create_connection((server.host, server.port), timeout=5) as link:
        host = host or f"127.0.0.1:{server.port}"
        link.sendall(f"{method} {path} HTTP/1.1\r\nHost: {host}\r\n{extra}\r\n".encode())
        answer = b""
        while part := link.recv(1 << 16):
            answer += part
    head, _, body = answer.partition(b"\r\n\r\n")
    return int(head.split()[1]), body


@contextmanager
def page(server, **more):
    origin = f"http://127.0.0.1:{server.port}"
    address = server.address.replace("http", "ws", 1) + "socket"
    with connect(address, **({"origin": origin, "max_size": None} | more)) as link:
        yield link


def wait(condition):
    end = time.monotonic() + 5
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def unpack(message):
    (length,) = struct.unpack(">I", message[:4])
    return json.loads(message[4 : 4 + length]), message[4 + length :]


def test_the_address_has_the_page_and_nothing_else(server):
    status, body = ask(server, f"/{server.token}/")
    assert status == 200 and b"<title>gpf view</title>" in body
    for path in ("other", "../server.py", "%2e%2e/server.py", "socket/../x", "page.html"):
        assert ask(server, f"/{server.token}/{path}")[0] == 404


@pytest.mark.parametrize(
    "path", ["/", "//", "/wrong/", "/wrong/socket", "/../../etc/passwd", "/%00"]
)
def test_without_the_token_there_is_nothing(server, path):
    status, body = ask(server, path)
    assert status == 403 and b"<title>" not in body


def test_another_host_or_origin_is_refused(server):
    for host in ("evil.example", f"evil.example:{server.port}", "127.0.0.1.evil.example", "[::1"):
        assert ask(server, f"/{server.token}/", host=host)[0] == 403
    # A tunnel may begin at another port.
    for host in (f"localhost:{server.port}", "localhost:9000", "127.0.0.1:80", "localhost"):
        assert ask(server, f"/{server.token}/", host=host)[0] == 200
    for origin in ("http://evil.example", "null", None):
        with pytest.raises(InvalidStatus) as refused, page(server, origin=origin):
            pass
        assert refused.value.response.status_code == 403


def test_with_another_host_any_name_will_do_but_not_another_origin(ear):
    server = PageServer(ear, host="0.0.0.0")
    try:
        connected = f"10.1.2.3:{server.port}"
        with socket.create_connection(("127.0.0.1", server.port), timeout=5) as link:
            link.sendall(f"GET /{server.token}/ HTTP/1.1\r\nHost: {connected}\r\n\r\n".encode())
            assert b" 200 " in link.recv(100)
        for origin, status in (
            (f"http://{connected}", b" 101 "),
            ("http://evil.example", b" 403 "),
        ):
            with socket.create_connection(("127.0.0.1", server.port), timeout=5) as link:
                link.sendall(
                    f"GET /{server.token}/socket HTTP/1.1\r\nHost: {connected}\r\n"
                    f"Origin: {origin}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
                    "Sec-WebSocket-Version: 13\r\n"
                    "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n".encode()
                )
                assert status in link.recv(100)
    finally:
        server.close()


def test_a_page_through_a_tunnel_to_another_port(server, ear):
    """As of `ssh -L 9000:127.0.0.1:PORT`; another page at a port of this machine is refused."""
    address = f"ws://localhost:9000/{server.token}/socket"

    def come_from(origin):
        link = socket.create_connection((server.host, server.port), timeout=5)
        with connect(address, sock=link, origin=origin):
            wait(lambda: len(ear.clients) == 1)

    come_from("http://localhost:9000")
    with pytest.raises(InvalidStatus, match="403"):
        come_from("http://localhost:9001")


@pytest.mark.skipif(not socket.has_dualstack_ipv6(), reason="no IPv6 here")
@pytest.mark.parametrize("host", ["::1", "::"])
def test_addresses_of_ipv6(ear, host):
    server = PageServer(ear, host=host)
    try:
        shown = "[::1]" if host == "::1" else socket.gethostname()
        assert server.address.startswith(f"http://{shown}:{server.port}/")
        for way in ("::1", "127.0.0.1") if host == "::" else ("::1",):
            with socket.create_connection((way, server.port), timeout=5) as link:
                request = f"GET /{server.token}/ HTTP/1.1\r\nHost: [::1]:{server.port}\r\n\r\n"
                link.sendall(request.encode())
                assert b" 200 " in link.recv(100)
    finally:
        server.close()


@pytest.mark.parametrize("host", ["no-such-host.invalid", "192.0.2.1"])
def test_a_host_that_is_not_this_machine_is_named(host):
    with pytest.raises(UserError, match=rf"--host {host}: cannot be used: .*address of this mach"):
        PageServer(Ear(), host=host)


def test_messages_arrive_and_pictures_leave(server, ear):
    with page(server) as link:
        link.send(json.dumps({"type": "camera", "camera": CAMERA, "number": 3}))
        link.send(json.dumps({"type": "look", "rows": 256, "stops": 1.5}))
        wait(lambda: len(ear.messages) == 2)
        assert isinstance(ear.messages[0], Camera) and ear.messages[0].number == 3
        assert isinstance(ear.messages[1], Look) and ear.messages[1].stops == 1.5
        ear.clients[0].show({"camera": 3}, b"a picture")
        header, data = unpack(link.recv())
        assert header == {"type": "picture", "picture": 1, "camera": 3} and data == b"a picture"
    wait(lambda: ear.left == 1)


def test_a_slow_page_gets_the_newest_picture_only(server, ear):
    with page(server) as link:
        wait(lambda: ear.clients)
        client = ear.clients[0]
        for k in range(10):
            client.show({"k": k}, b"")
            time.sleep(0.02)
        first = [unpack(link.recv())[0] for _ in range(2)]
        assert [f["k"] for f in first] == [0, 1] and not client.waits
        with pytest.raises(TimeoutError):
            link.recv(timeout=0.2)
        link.send(json.dumps({"type": "seen", "picture": 2}))
        assert unpack(link.recv())[0] == {"type": "picture", "picture": 3, "k": 9}


def test_a_page_that_does_not_listen_holds_no_old_states():
    client = Client(None)
    for k in range(1000):
        client.tell({"type": "status", "passes": k})
    client.tell({"type": "error", "text": "one"})
    client.tell({"type": "error", "text": "two"})
    client.tell({"type": "status", "passes": 1000})
    messages = [unpack(client._next())[0] for _ in range(4)]
    assert [message.get("passes", message.get("text")) for message in messages] == [
        999,
        "one",
        "two",
        1000,
    ]


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        "null",
        '{"type": "rm"}',
        '{"type": "look", "rows": 1e9}',
        '{"type": "look", "rows": 256, "more": 1}',
        '{"type": "look", "stops": NaN}',
        '{"type": "camera", "number": 1, "camera": {"fov": 4}}',
        '{"type": "film", "keyframes": [], "frames": 3}',
        b"\xff\xfe",
    ],
)
def test_what_is_no_message_is_answered_with_words(server, ear, text):
    with page(server) as link:
        link.send(text)
        header, _ = unpack(link.recv())
        assert header["type"] == "error" and "Reload the page" in header["text"]
        link.send(json.dumps({"type": "exr"}))
        wait(lambda: len(ear.messages) == 1)


def test_who_sends_only_nonsense_or_too_much_is_disconnected(server, ear):
    for text, count in (("nonsense", MOST_MISTAKES + 2), ("x" * (MOST_BYTES + 1), 1)):
        with page(server) as link, pytest.raises(ConnectionClosed):
            for _ in range(count):
                link.send(text)
            while True:
                link.recv(timeout=5)
    with page(server) as link:
        link.send(json.dumps({"type": "exr"}))
        wait(lambda: len(ear.messages) == 1)


def test_a_message_without_an_end_is_cut_off(server, ear):
    """Small pieces, none of them the last."""
    with page(server) as endless:
        with pytest.raises(ConnectionClosed):
            endless.send("x" * 1000 for _ in range(1_000_000))
        assert not ear.messages
    with page(server) as other:
        other.send('{"type": "seen", "picture": 1}')
        wait(lambda: ear.messages)


def test_half_a_request_does_not_hold_up_others(server):
    with socket.create_connection((server.host, server.port)) as idle:
        idle.sendall(b"GET / HT")
        assert ask(server, f"/{server.token}/")[0] == 200


def test_a_port_in_use_is_named(server):
    with pytest.raises(UserError, match=f"--port {server.port}: cannot be used.*Choose another"):
        PageServer(Ear(), port=server.port)


def test_a_message_says_where_it_is_wrong():
    with pytest.raises(UserError, match="message: look.rows: Input should be less"):
        read_message('{"type": "look", "rows": 99999}')

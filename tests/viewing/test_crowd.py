"""Connections that say nothing: they neither fill the process nor keep out pages."""

from __future__ import annotations

import json
import socket
import threading
import time
from contextlib import ExitStack

import pytest

from gpf.viewing import server as module
from gpf.viewing.door import Door
from gpf.viewing.server import MOST_STRANGERS, PageServer
from tests.viewing.test_server import Ear, ask, page, unpack, wait

CROWD = 300


@pytest.fixture
def ear():
    return Ear()


def connect_idle(server, stack, sent=b""):
    """A connection that sends no more than this."""
    link = stack.enter_context(socket.create_connection((server.host, server.port), timeout=5))
    link.sendall(sent)
    return link


def answers(link, ear):
    """Whether an open page hears and is heard."""
    before = len(ear.messages)
    link.send(json.dumps({"type": "exr"}))
    wait(lambda: len(ear.messages) > before)
    ear.clients[0].tell({"type": "hello"})
    return unpack(link.recv(timeout=5))[0]["type"] == "hello"


@pytest.mark.parametrize("sent", [b"", b"GET / HT", b"GET /x/ HTTP/1.1\r\nHost: x\r\n"])
def test_idle_connections_take_few_threads_and_keep_nobody_out(ear, sent):
    server = PageServer(ear)
    try:
        with ExitStack() as stack:
            link = stack.enter_context(page(server))  # open before
            wait(lambda: ear.clients)
            before = most = threading.active_count()
            idle = []
            for _ in range(CROWD):
                idle.append(connect_idle(server, stack, sent))
                most = max(most, threading.active_count())
            assert most - before <= 2 * MOST_STRANGERS + 4
            # All that have been refused are closed, the newest are waited for.
            for one in idle[:-MOST_STRANGERS]:
                assert one.recv(1) == b""
            most = max(most, threading.active_count())
            assert most - before <= 2 * MOST_STRANGERS + 4
            start = time.monotonic()
            assert ask(server, f"/{server.token}/")[0] == 200
            with page(server) as other:
                other.send(json.dumps({"type": "exr"}))
                wait(lambda: len(ear.messages) == 1)
            assert time.monotonic() - start < module.HANDSHAKE_SECONDS
            assert answers(link, ear)
    finally:
        server.close()


def test_who_says_nothing_in_time_is_disconnected_and_pages_are_not(ear, monkeypatch):
    monkeypatch.setattr(module, "HANDSHAKE_SECONDS", 0.5)
    server = PageServer(ear)
    try:
        with ExitStack() as stack:
            link = stack.enter_context(page(server))
            wait(lambda: ear.clients)
            before = threading.active_count()
            idle = [connect_idle(server, stack) for _ in range(MOST_STRANGERS - 1)]
            slow = connect_idle(server, stack)
            start = time.monotonic()
            with pytest.raises(OSError):  # a byte at a time does not help
                for byte in b"GET / HTTP/1.1\r\nHost: somewhere\r\n" * 10:
                    slow.sendall(bytes([byte]))
                    time.sleep(0.05)
            assert time.monotonic() - start < 3
            assert all(one.recv(1) == b"" for one in idle)
            wait(lambda: threading.active_count() <= before)
            assert ask(server, f"/{server.token}/")[0] == 200
            assert answers(link, ear)
    finally:
        server.close()


def test_pages_with_the_token_are_not_counted(ear):
    """More of them than strangers may be there."""
    server = PageServer(ear)
    try:
        with ExitStack() as stack:
            links = [stack.enter_context(page(server)) for _ in range(MOST_STRANGERS + 5)]
            wait(lambda: len(ear.clients) == len(links))
            for _ in range(2 * MOST_STRANGERS):
                connect_idle(server, stack)
            assert ask(server, f"/{server.token}/")[0] == 200
            for number, link in enumerate(links):
                link.send(json.dumps({"type": "exr"}))
                wait(lambda: len(ear.messages) > number)  # noqa: B023
            assert ear.left == 0
    finally:
        server.close()


def test_a_server_that_closes_does_not_wait_for_a_crowd(ear):
    server = PageServer(ear)
    with ExitStack() as stack:
        for _ in range(CROWD):
            connect_idle(server, stack)
        start = time.monotonic()
        server.close()
        assert time.monotonic() - start < 1
        with pytest.raises(OSError):
            for _ in range(3):
                socket.create_connection((server.host, server.port), timeout=1).close()
                time.sleep(0.2)


def test_one_that_cannot_be_got_rid_of_costs_no_more_threads():
    """As if the server's thread for it did not end."""
    with Door("127.0.0.1", 0, most=2) as door, ExitStack() as stack:
        address = door.getsockname()
        links = [
            stack.enter_context(socket.create_connection(address, timeout=5)) for _ in range(4)
        ]
        kept = [stack.enter_context(door.accept()[0]) for _ in range(2)]
        waiting = threading.Thread(target=lambda: kept.append(door.accept()[0]))
        waiting.start()
        assert links[2].recv(1) == b""  # refused
        assert len(kept) == 2
        kept[1].close()
        waiting.join(5)
        assert len(kept) == 3 and kept[2].getpeername() == links[3].getsockname()
        kept[2].close()

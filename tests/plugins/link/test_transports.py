"""A line behaves alike by descriptor, by socket, and by a port without descriptors as on Windows."""

from __future__ import annotations

import os
import select
import socket
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest

from plugins.link._line import Line
from plugins.link._transports import PortTransport

Far = tuple[Callable[[bytes], object], Callable[[], bytes]]


@pytest.fixture(params=["descriptor", "socket", "port"])
def line(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Line, Far]]:
    """An open line, and how the other end writes and reads."""
    with ExitStack() as closing:
        if request.param == "socket":
            server = closing.enter_context(socket.create_server(("127.0.0.1", 0)))
            opened = Line(f"socket://127.0.0.1:{server.getsockname()[1]}", 115200)
            far = closing.enter_context(server.accept()[0])
            ends: Far = (far.sendall, lambda: far.recv(100))
        else:
            if request.param == "port":
                monkeypatch.delattr(select, "poll")
            master, slave = os.openpty()
            tty.setraw(slave)
            closing.callback(os.close, master)
            opened = Line(os.ttyname(slave), 115200)
            os.close(slave)
            ends = (lambda data: os.write(master, data), lambda: os.read(master, 100))
            assert isinstance(opened._transport, PortTransport) == (request.param == "port")
        closing.callback(opened.close)
        yield opened, ends


def test_bytes_go_both_ways(line: tuple[Line, Far]) -> None:
    near, (write, read) = line
    write(b"up")
    assert near.read(1.0) == b"up"
    assert near.write(b"down", 1.0)
    assert read() == b"down"


def test_silence_ends_with_the_time(line: tuple[Line, Far]) -> None:
    near, _ = line
    begun = time.monotonic()
    assert near.read(0.05) == b""
    assert 0.04 < time.monotonic() - begun < 1.0

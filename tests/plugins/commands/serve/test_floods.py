"""Whatever other clients do, events, stop and next start work for everybody, and the server always ends."""

from __future__ import annotations

import asyncio
import random
import signal
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path
from typing import Any

import pytest
import uvicorn
import yaml

from plugins.commands.serve._connections import Connection
from plugins.commands.serve._server import _Server
from plugins.commands.serve._viewers import Viewers
from tests.plugins.commands.serve.flooding import Watcher, lines, tabs
from tests.plugins.commands.serve.served import Served, serving
from tests.plugins.commands.serve.test_serving import ASKING, ended_safely, is_armed, until_energised
from tests.support.processes import wait_until
from tests.support.tiny import tiny_document

pytestmark = pytest.mark.timeout(240)

LONG: list[dict[str, Any]] = [*ASKING[:2], ASKING[2] | {"points_a": [[1.0, 0.0] for _ in range(900)]}]
MAX_SECONDS_TO_STOP = 5.0
"""Until the current is zero and the drive disarmed, on a machine that others use too."""


@pytest.fixture
def served(tmp_path: Path) -> Iterator[Served]:
    document = tiny_document(stages=LONG, drive={"realtime_factor": 1.0, "watchdog_s": 60.0})
    (tmp_path / "asking.yaml").write_text(yaml.safe_dump(document))
    with serving(tmp_path) as served:
        yield served


def withstood(served: Served, attack: Callable[[], AbstractContextManager[Any]], seconds: float) -> dict[str, float]:
    """An attack on a run with current: events arrive meanwhile, and a stop is a stop; the figures."""
    run = until_energised(served)
    watcher = Watcher(served)
    with attack():
        time.sleep(seconds)
        figures = {"events": len(watcher.views), "longest gap [s]": watcher.longest_gap_s}
        begun_s = time.monotonic()
        assert served.post("/stop", {}).status == 200
        figures["stop answered [s]"] = time.monotonic() - begun_s
        watcher.seconds_until(lambda view: not is_armed(view))
        figures["stopped [s]"] = time.monotonic() - begun_s
        watcher.seconds_until(lambda view: not view["going"])
        assert served.post("/start", {"procedure": "asking.yaml"}).status == 200
    ended_safely(run)
    assert figures["longest gap [s]"] < 3.0, figures
    assert figures["stopped [s]"] < MAX_SECONDS_TO_STOP, figures
    begun_s = time.monotonic()
    served.process.send_signal(signal.SIGINT)
    served.process.communicate(timeout=60)
    assert served.process.returncode == 0
    return {name: round(value, 2) for name, value in figures.items()} | {"ended [s]": time.monotonic() - begun_s}


def test_tabs_that_come_and_go_take_nothing_from_the_others(served: Served) -> None:
    withstood(served, lambda: tabs(served, 10, random.Random(1)), 1.0)


@pytest.mark.slow
@pytest.mark.parametrize("attack", ["tabs", "streams", "slow readers", "silence", "all"])
def test_floods_take_nothing_from_the_others(attack: str, served: Served) -> None:
    def flood() -> ExitStack:
        opened = ExitStack()
        if attack in ("tabs", "all"):
            opened.enter_context(tabs(served, 200 if attack == "tabs" else 50, random.Random(2)))
        if attack in ("streams", "all"):
            opened.enter_context(lines(served, 500, silent=False, read=True))
        if attack in ("slow readers", "all"):
            opened.enter_context(lines(served, 100, silent=False))
        if attack in ("silence", "all"):
            opened.enter_context(lines(served, 1500, silent=True))
        return opened

    print(f"\n{attack}: {withstood(served, flood, 15.0)}")


def test_a_second_signal_ends_the_server_at_once_and_the_run_by_itself(served: Served) -> None:
    run = until_energised(served)
    served.process.send_signal(signal.SIGINT)
    time.sleep(0.05)
    served.process.send_signal(signal.SIGINT)
    begun_s = time.monotonic()
    _, errors = served.process.communicate(timeout=10)
    assert served.process.returncode == 130
    assert time.monotonic() - begun_s < 2.0
    assert errors.splitlines()[-1] == "fluxbench: ended without waiting; an active run stops by itself"
    ended_safely(run)


def test_a_stream_too_many_ends_the_oldest() -> None:
    async def newest_three() -> tuple[int, list[bytes]]:
        viewers = Viewers({"n": 0}, max_streams=3)
        streams = [viewers.events() for _ in range(5)]
        first = [await anext(stream) for stream in streams]
        assert all(event.endswith(b'data: {"n": 0}\n\n') for event in first)
        viewers.publish({"n": 1})
        rest = [event async for event in streams[0]]
        open_streams = len(viewers)
        return open_streams, rest + [await anext(stream) for stream in streams[2:]]

    assert asyncio.run(newest_three()) == (3, [b'data: {"n": 1}\n\n'] * 4)


def test_a_reader_that_is_slow_receives_the_newest_state_alone() -> None:
    async def received() -> list[bytes]:
        viewers = Viewers({"n": 0})
        stream = viewers.events()
        events = [await anext(stream)]
        for n in range(1, 1000):
            viewers.publish({"n": n})
        events.append(await anext(stream))
        viewers.close()
        return events[1:] + [event async for event in stream]

    assert asyncio.run(received()) == [b'data: {"n": 999}\n\n'] * 2


def test_without_news_a_stream_receives_the_age_of_the_state() -> None:
    async def second() -> bytes:
        stream = Viewers({}).events()
        await anext(stream)
        return await anext(stream)

    name, data = asyncio.run(second()).decode().split("\n")[:2]
    assert name == "event: alive"
    assert data.startswith('data: {"age_s": 1.')


class _Impatient(Connection):
    max_connections = 20
    client_timeout_s = 0.5


async def _answering(scope: Any, receive: Any, send: Any) -> None:
    """Answers /wide with more than the buffers hold, and everything else with a word."""
    await send({"type": "http.response.start", "status": 200, "headers": []})
    for _ in range(400 if scope["path"] == "/wide" else 0):
        await send({"type": "http.response.body", "body": b"x" * 50_000, "more_body": True})
    await send({"type": "http.response.body", "body": b"yes"})


@pytest.fixture
def port() -> Iterator[int]:
    import threading

    listening = socket.socket()
    listening.bind(("127.0.0.1", 0))
    config = uvicorn.Config(_answering, http=_Impatient, lifespan="off", log_config=None, timeout_graceful_shutdown=1)
    server = _Server(config)
    thread = threading.Thread(target=asyncio.run, args=(server.serve([listening]),), daemon=True)
    number = int(listening.getsockname()[1])
    thread.start()
    wait_until(lambda: server.started, 10.0)
    yield number
    server.should_exit = True
    thread.join(timeout=10.0)


def is_closed(line: socket.socket, within_s: float = 3.0) -> bool:
    line.settimeout(within_s)
    try:
        while line.recv(100):
            pass
    except ConnectionError:
        return True
    except TimeoutError:
        return False
    return True


@pytest.mark.parametrize(
    "sent",
    [
        b"",
        b"GET",
        b"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: 10\r\n\r\nfive.",
        b"GET / HTTP/1.1\r\nHost: x\r\n\r\nG",
    ],
)
def test_a_client_that_sends_no_whole_request_is_dropped(sent: bytes, port: int) -> None:
    with socket.create_connection(("127.0.0.1", port)) as line:
        line.sendall(sent)
        assert is_closed(line)


def test_of_too_many_connections_the_one_that_waited_longest_is_dropped(port: int) -> None:
    with ExitStack() as opened:
        many = [opened.enter_context(socket.create_connection(("127.0.0.1", port))) for _ in range(20)]
        with socket.create_connection(("127.0.0.1", port)) as line:
            line.sendall(b"GET / HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n")
            line.settimeout(5.0)
            assert b"200" in line.recv(1000)
        assert is_closed(many[0], 0.2)
        many[-1].settimeout(0.05)
        with pytest.raises(TimeoutError):
            many[-1].recv(1)


@pytest.mark.slow
def test_a_client_that_reads_no_answer_is_dropped(served: Served) -> None:
    request = f"GET /?token={served.token} HTTP/1.1\r\nHost: 127.0.0.1:{served.port}\r\n\r\n".encode()
    with socket.socket() as line:
        line.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        line.connect(("127.0.0.1", served.port))
        line.settimeout(0.2)
        begun_s = time.monotonic()

        def is_dropped() -> bool:
            try:
                line.send(request)
            except TimeoutError:  # the server reads no more of it
                return line.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR) != 0
            except OSError:
                return True
            return False

        wait_until(is_dropped, 60.0)
    assert time.monotonic() - begun_s > 0.5 * Connection.client_timeout_s

"""The server process of the page: socket, address and shutdown."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType

import uvicorn

from orchestrator.formatting.sentences import shown
from orchestrator.operating_system.signals import STOP_SIGNALS
from plugins.commands.serve._app import page_app
from plugins.commands.serve._connections import Connection
from plugins.commands.serve._guard import new_token
from plugins.commands.serve._run import RunOfThePage
from protocols import InputError

ACCEPTED_AT_ONCE = 32
"""Connections between two looks at what clients sent: fewer than `Connection.max_connections`."""
WAITING_CONNECTIONS = 1024


def serve_page(folder: Path, host: str, port: int) -> int:
    """Print the address with its token, and serve until a signal, which stops an active run.

    Raises
    ------
    InputError
        The port is taken.
    """
    with _bound(host, port) as listening:
        return asyncio.run(_serve(folder, listening))


async def _serve(folder: Path, listening: socket.socket) -> int:
    token, run = new_token(), RunOfThePage(folder)
    config = uvicorn.Config(
        page_app(run, folder, token),
        http=Connection,
        backlog=ACCEPTED_AT_ONCE,
        access_log=False,  # addresses contain the token
        log_config=None,
        log_level="critical",
        server_header=False,
        ws="none",
        timeout_graceful_shutdown=2,
    )
    host, port = listening.getsockname()
    print(f"http://{host}:{port}/?token={token}", flush=True)
    _print_message(f"open this address in a browser on this machine, for {shown(str(folder))}")
    _print_message("Ctrl-C ends the server and an active run")
    server = _Server(config)
    _end_by_signals(server, run)
    await server.serve([listening])
    if run.is_going:
        _print_message("the run has not ended yet; it stops by itself")
    return 0


class _Server(uvicorn.Server):
    """A server that does not handle signals, and drops connections whose clients are overdue."""

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        yield

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        for listening in sockets or ():
            listening.listen(WAITING_CONNECTIONS)  # asyncio has set the number that it accepts at once

    async def on_tick(self, counter: int) -> bool:
        now_s = time.monotonic()
        for connection in list(self.server_state.connections):
            if isinstance(connection, Connection):
                connection.drop_if_overdue(now_s)
        return await super().on_tick(counter)


def _end_by_signals(server: uvicorn.Server, run: RunOfThePage) -> None:
    """Handle signals: the first stops an active run and then the server, the second ends this process at once.

    The second needs no event loop. A run that is still active then finds its pipe closed, and stops by itself.
    """
    loop = asyncio.get_running_loop()
    ending: list[asyncio.Task[None]] = []
    names: list[str] = []

    async def end(name: str) -> None:
        try:
            await run.close(f"the page's server was ended by {name}")
        finally:
            server.should_exit = True

    def handle(number: int, frame: FrameType | None) -> None:
        if names:
            _print_message("ended without waiting; an active run stops by itself")
            os._exit(130)
        names.append(signal.Signals(number).name)
        if run.is_going:
            _print_message("stopping the run; another signal ends the server without waiting")
        loop.call_soon_threadsafe(lambda: ending.append(loop.create_task(end(names[0]))))

    for number in STOP_SIGNALS:
        signal.signal(number, handle)


def _bound(host: str, port: int) -> socket.socket:
    listening = socket.socket()
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind((host, port))
        listening.listen()  # before the address is printed
    except OSError as error:
        listening.close()
        raise InputError("--port", "", f"{port}: {error.strerror}") from None
    return listening


def _print_message(line: str) -> None:
    with suppress(OSError):  # the terminal has been closed; no buffer, since a signal's handler prints too
        os.write(sys.stderr.fileno(), f"fluxbench: {line}\n".encode(errors="replace"))

"""The process that serves the page: its socket, its address, and its end."""

from __future__ import annotations

import asyncio
import signal
import socket
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import uvicorn

from orchestrator.formatting.sentences import shown
from plugins.commands.serve._app import page_app
from plugins.commands.serve._guard import new_token
from plugins.commands.serve._run import RunOfThePage
from protocols import InputError


def serve_page(folder: Path, host: str, port: int) -> int:
    """Print the address with its token, and serve until a signal; a run that is going is stopped then.

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
        access_log=False,  # addresses hold the token
        log_config=None,
        log_level="critical",
        server_header=False,
        ws="none",
        timeout_graceful_shutdown=2,
    )
    host, port = listening.getsockname()
    print(f"http://{host}:{port}/?token={token}", flush=True)
    _tell(f"open this address in a browser on this machine, for {shown(str(folder))}")
    _tell("Ctrl-C ends it, and a run that is going")
    server = _Server(config)
    _end_by_signals(server, run)
    await server.serve([listening])
    if run.is_going:
        _tell("the run has not ended yet: it stops by itself")
    return 0


class _Server(uvicorn.Server):
    """A server that leaves signals alone."""

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        yield


def _end_by_signals(server: uvicorn.Server, run: RunOfThePage) -> None:
    """The first signal stops a run that is going, and then the server; the second one the server at once."""
    ending: list[asyncio.Task[None]] = []

    async def end(name: str) -> None:
        if run.is_going:
            _tell("stopping the run; once more leaves it to end by itself")
        await run.close(f"the page's server was ended by {name}")
        server.should_exit = True

    def handle(number: signal.Signals) -> None:
        if ending:
            server.should_exit = server.force_exit = True
        ending.append(asyncio.ensure_future(end(number.name)))

    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        asyncio.get_running_loop().add_signal_handler(number, handle, number)


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


def _tell(line: str) -> None:
    with suppress(OSError):  # the terminal is gone
        print(f"fluxbench: {line}", file=sys.stderr, flush=True)

"""The server process of the page: socket, address and shutdown."""

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
    """A server that does not handle signals."""

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        yield


def _end_by_signals(server: uvicorn.Server, run: RunOfThePage) -> None:
    """Handle signals: the first stops an active run and then the server, the second the server at once."""
    ending: list[asyncio.Task[None]] = []

    async def end(name: str) -> None:
        if run.is_going:
            _print_message("stopping the run; another signal ends the server without waiting")
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


def _print_message(line: str) -> None:
    with suppress(OSError):  # the terminal has been closed
        print(f"fluxbench: {line}", file=sys.stderr, flush=True)

"""Where the work is done: worker processes on this machine, or the workers of a scheduler that is there."""

from __future__ import annotations

import logging
import os
import signal
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from pydantic import Field

from protocols import InputError, RunInterrupted, Strict

if TYPE_CHECKING:
    from distributed import Client

LOOPBACK = "127.0.0.1"
DEAF = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)"
"""What a worker here begins with: Ctrl-C at a terminal reaches it too, and it is the client that ends it."""


class ClusterSettings(Strict):
    """Which workers."""

    jobs: int = Field(default_factory=lambda: os.cpu_count() or 1, ge=1)
    """Worker processes on this machine, one thread each."""
    scheduler: str | None = None
    """``tcp://HOST:PORT`` of one that is there; then its workers are taken, and none is started."""
    dashboard_port: int = Field(default=8787, ge=0, le=65535)
    """Of the local cluster's page on 127.0.0.1; another where it is taken."""
    wait_s: float = Field(default=60.0, gt=0)
    """For a first worker."""


@contextmanager
def connected(settings: ClusterSettings) -> Iterator[Client]:
    """A client of the workers, for the length of a with-block.

    Raises
    ------
    InputError
        Where dask is not installed, or no scheduler answers, or it has no worker.
    RunInterrupted
        By Ctrl-C or SIGTERM; what was done until then is kept by whoever keeps it.
    """
    try:
        import dask
        from distributed import Client, LocalCluster
        from distributed.security import Security

        # Whoever reaches a scheduler can have code run: other users of this machine have not the key.
        security = Security.temporary()
    except ImportError as error:
        problem = f"runs on dask: pip install 'fluxbench[fleet]' ({error})"
        raise InputError("fleet", "", problem) from None
    for name in [known for known in logging.root.manager.loggerDict if known.startswith("distributed")]:
        logging.getLogger(name).setLevel(logging.CRITICAL)  # what matters of it is in the table
    if settings.scheduler is not None:
        with _interruptible(), _client_of(settings.scheduler, settings) as client:
            yield client
        return
    port = _free(settings.dashboard_port)
    # A task whose worker died is this project's to ask again, once: dask itself would do so three times.
    with (
        _interruptible(),
        dask.config.set(
            {
                "distributed.scheduler.allowed-failures": 0,
                "distributed.worker.preload": [DEAF],
                # A worker's memory is its task's own, nothing of dask's: a pause would free none and last for ever.
                "distributed.worker.memory.target": False,
                "distributed.worker.memory.spill": False,
                "distributed.worker.memory.pause": False,
                "distributed.worker.profile.enabled": False,  # looks at each worker's stack a hundred times a second
                "distributed.nanny.environ.PYTHONWARNINGS": "ignore",
                # No page from elsewhere is told what is under way.
                "distributed.scheduler.dashboard.bokeh-application.allow_websocket_origin": [
                    f"{name}:{port}" for name in (LOOPBACK, "localhost")
                ],
            }
        ),
        LocalCluster(
            n_workers=settings.jobs,
            threads_per_worker=1,
            processes=True,
            host=LOOPBACK,
            dashboard_address=f"{LOOPBACK}:{port}",
            security=security,
            silence_logs=logging.CRITICAL,
        ) as cluster,
        Client(cluster, set_as_default=False) as client,
    ):
        yield client


@contextmanager
def _interruptible() -> Iterator[None]:
    """SIGTERM ends the block as Ctrl-C does, with one line; off the main thread, signals are not its own."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    except KeyboardInterrupt:
        raise RunInterrupted("interrupted; started again, the job goes on where it was") from None
    finally:
        signal.signal(signal.SIGTERM, before)


def _free(port: int) -> int:
    """The port, or another where somebody has it."""
    with socket.socket() as tried:
        tried.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            tried.bind((LOOPBACK, port))
        except OSError:
            tried.bind((LOOPBACK, 0))
        return int(tried.getsockname()[1])


def _client_of(address: str, settings: ClusterSettings) -> Client:
    from distributed import Client

    try:
        client = Client(address, timeout=settings.wait_s, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError("--scheduler", address, f"no scheduler answers there ({type(error).__name__})") from None
    try:
        client.wait_for_workers(1, timeout=settings.wait_s)
    except TimeoutError:
        client.close()
        raise InputError("--scheduler", address, f"has no worker after {settings.wait_s:g} s") from None
    return client

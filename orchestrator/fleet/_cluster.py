"""The workers: processes on this machine, or the workers of an existing scheduler."""

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
DASHBOARD_ROUTES = ["distributed.http.health", "distributed.http.statics"]
"""Routes of dask's beside the dashboard; its others serve data to any host name, or load styles from elsewhere."""
IGNORE_SIGINT = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)"
"""First code of a local worker: Ctrl-C at a terminal reaches it too, but only the client may end it."""


class ClusterSettings(Strict):
    """The choice of workers."""

    jobs: int = Field(default_factory=lambda: os.cpu_count() or 1, ge=1)
    """Worker processes on this machine, one thread each."""
    scheduler: str | None = None
    """``tcp://HOST:PORT`` of an existing scheduler, whose workers are used; none is started then."""
    dashboard_port: int | None = Field(default=None, ge=0, le=65535)
    """Port of the local cluster's page on 127.0.0.1, another one where it is in use; None: no page. It asks for no
    token: every user of this machine can read it."""
    wait_s: float = Field(default=60.0, gt=0)
    """Waiting time for a first worker [s]."""


@contextmanager
def connected(settings: ClusterSettings) -> Iterator[Client]:
    """A client of the workers, for the length of a with-block.

    Raises
    ------
    InputError
        Where dask is not installed, or no scheduler answers, or it has no worker.
    RunInterrupted
        By Ctrl-C or SIGTERM; rows written until then stay.
    """
    try:
        import dask
        from distributed import Client, LocalCluster
        from distributed.security import Security

        # A scheduler runs any code that it receives: without the key, other users of this machine cannot send any.
        security = Security.temporary()
    except ImportError as error:
        problem = f"runs on dask: pip install 'fluxbench[fleet]' ({error})"
        raise InputError("fleet", "", problem) from None
    for name in [known for known in logging.root.manager.loggerDict if known.startswith("distributed")]:
        logging.getLogger(name).setLevel(logging.CRITICAL)  # the table has the relevant errors
    if settings.scheduler is not None:
        with _interruptible(), _client_of(settings.scheduler, settings) as client:
            yield client
        return
    has_page = settings.dashboard_port is not None
    port = _free(settings.dashboard_port or 0)
    # The engine repeats a task whose worker died, once; dask itself would do so three times.
    with (
        _interruptible(),
        dask.config.set(
            {
                "distributed.scheduler.allowed-failures": 0,
                "distributed.worker.preload": [IGNORE_SIGINT],
                # A worker's memory belongs to its task, not to dask: a pause would free none and last for ever.
                "distributed.worker.memory.target": False,
                "distributed.worker.memory.spill": False,
                "distributed.worker.memory.pause": False,
                "distributed.worker.profile.enabled": False,  # samples each worker's stack a hundred times a second
                "distributed.nanny.environ.PYTHONWARNINGS": "ignore",
                "distributed.scheduler.http.routes": DASHBOARD_ROUTES if has_page else [],
                "distributed.worker.http.routes": [],
                "distributed.nanny.http.routes": [],
                # Pages of other origins get no data.
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
            dashboard_address=f"{LOOPBACK}:{port}",  # dask listens there in any case; without routes nothing answers
            scheduler_kwargs={"dashboard": has_page},
            security=security,
            silence_logs=logging.CRITICAL,
        ) as cluster,
        Client(cluster, set_as_default=False) as client,
    ):
        yield client


@contextmanager
def _interruptible() -> Iterator[None]:
    """SIGTERM ends the block as Ctrl-C does, with one line; without effect outside the main thread."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    except KeyboardInterrupt:
        raise RunInterrupted("interrupted; started again, the job continues where it stopped") from None
    finally:
        signal.signal(signal.SIGTERM, before)


def _free(port: int) -> int:
    """The port, or another one where it is in use."""
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

"""Processes that a fleet needs beside it: a scheduler with workers, and a server that speaks S3; all on loopback."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path

import psutil

from tests.support.processes import wait_until

AWS = {
    "AWS_ACCESS_KEY_ID": "bench",
    "AWS_SECRET_ACCESS_KEY": "bench",
    "AWS_DEFAULT_REGION": "us-east-1",
    "AWS_EC2_METADATA_DISABLED": "true",
}
"""What a client says of itself; the server takes anybody."""


@contextmanager
def process(*words: str, env: Mapping[str, str] | None = None, log: Path) -> Iterator[subprocess.Popen[bytes]]:
    """A Python module as a process of its own, ended with all its children."""
    with log.open("wb") as output:
        started = subprocess.Popen(
            [sys.executable, "-m", *words], env={**os.environ, **(env or {})}, stdout=output, stderr=output
        )
    try:
        yield started
    finally:
        family = [*psutil.Process(started.pid).children(recursive=True)] if started.poll() is None else []
        started.terminate()
        _, left = psutil.wait_procs([psutil.Process(started.pid), *family] if started.poll() is None else family, 5.0)
        for one in left:
            one.kill()
        started.wait()


@contextmanager
def cluster_of_processes(folder: Path, workers: int = 2) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """Address of a scheduler, and the nannies of its workers."""
    file = folder / "scheduler.json"
    env = {"DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "0", "PYTHONWARNINGS": "ignore"}
    here = ("--host", "127.0.0.1", "--scheduler-file", str(file))
    scheduler = ("distributed.cli.dask_scheduler", *here, "--port", "0", "--dashboard-address", "127.0.0.1:0")
    worker = ("distributed.cli.dask_worker", *here, "--nthreads", "1")
    with ExitStack() as stack:
        stack.enter_context(process(*scheduler, env=env, log=folder / "scheduler.log"))
        wait_until(lambda: file.is_file() and file.read_text().rstrip().endswith("}"), 60.0)
        logs = [folder / f"worker-{n}.log" for n in range(workers)]
        yield _address_in(file), [stack.enter_context(process(*worker, env=env, log=log)) for log in logs]


def _address_in(file: Path) -> str:
    return str(json.loads(file.read_text())["address"])


@contextmanager
def s3_server(folder: Path) -> Iterator[str]:
    """The endpoint of a server that speaks S3."""
    log = folder / "s3.log"
    with process("moto.server", "-H", "127.0.0.1", "-p", "0", log=log) as started:
        yield f"http://127.0.0.1:{_port_of(started)}"


def _port_of(started: subprocess.Popen[bytes]) -> int:
    deadline = time.monotonic() + 60.0
    while time.monotonic() < deadline:
        for one in psutil.Process(started.pid).net_connections("tcp4"):
            if one.status == psutil.CONN_LISTEN:
                return int(one.laddr.port)
        time.sleep(0.05)
    raise TimeoutError("the S3 server does not listen")


def worker_of(nanny: subprocess.Popen[bytes]) -> psutil.Process | None:
    """The worker process that a nanny watches over; None while it is being started again."""
    children = psutil.Process(nanny.pid).children()
    return next((child for child in children if "multiprocessing.spawn" in " ".join(child.cmdline())), None)

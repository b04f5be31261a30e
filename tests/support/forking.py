"""The command line as a process that is not started from nothing: a fork of one that has imported everything.

Such a process has a pid, signals, output and an exit code of its own, like any other; it is spared some seconds of
imports. Whether the program starts by itself, and imports in time, is for tests that start it afresh.

A server forks: it has imported modules, has done nothing else, and is one thread. For each command it forks a guardian,
which forks the command, waits for it, and tells how it ended. The workers of one run of the tests have one server.
"""

from __future__ import annotations

import atexit
import errno
import functools
import gc
import importlib
import json
import os
import secrets
import select
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path

ROOT = Path(__file__).parents[2]
COMMANDS = ("_check", "_commission", "_diagnosis", "_further", "_output", "_results")
PLUGINS = ("drives", "stages", "estimators", "effects", "streams", "commands")
LIBRARIES = ("h5netcdf", "matplotlib.backends.backend_svg", "matplotlib.figure", "pandas", "pyarrow.parquet", "xarray")
WITH_THREADS = "plugins.streams.rerun"
"""Its library starts threads when it is imported, and threads do not live through a fork."""
FORKS_WELL = "jemalloc_bg_thd"
"""The one thread of pyarrow's allocator, which makes it anew after a fork."""
RUN_OF_TESTS = "PYTEST_XDIST_TESTRUNUID"
"""Variable by which pytest-xdist gives its workers the name of their run."""
NUMBER = struct.Struct("i")
LONGEST_REQUEST = 1 << 17


class ForkedCommand:
    """A command of `fluxbench` that runs; it is requested as a `subprocess.Popen` is.

    Attributes
    ----------
    pid : int
    returncode : int or None
        Minus the number of the signal that ended it; None while it runs.
    """

    def __init__(
        self,
        words: Sequence[str],
        cwd: Path | None = None,
        preload: Path | None = None,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        self.returncode: int | None = None
        self._outputs = [os.memfd_create(name) for name in ("stdout", "stderr")]
        self._printed = ("", "")
        self._reported, telling = os.pipe()
        self._hearing = threading.Lock()
        around = {**os.environ, **(environment or {})}
        request = json.dumps({"words": list(words), "cwd": str(cwd or Path.cwd()), "environment": around})
        socket.send_fds(_server(preload), [request.encode()], [*self._outputs, telling])
        os.close(telling)
        self.pid = self._hear()

    def poll(self) -> int | None:
        """Its exit code, or None while it runs."""
        return self._look(0.0)

    def wait(self, timeout: float | None = None) -> int:
        """Its exit code; raises `subprocess.TimeoutExpired`."""
        code = self._look(timeout)
        if code is None:
            raise subprocess.TimeoutExpired("fluxbench", timeout or 0.0)
        return code

    def communicate(self, timeout: float | None = None) -> tuple[str, str]:
        """All that it printed, and all that it stated on stderr; raises `subprocess.TimeoutExpired`."""
        self.wait(timeout)
        return self._printed

    def printed_so_far(self) -> str:
        """What it has printed by now, while it runs."""
        output = self._outputs[0]
        # The command writes where the descriptor's offset is: it has to stay there.
        return os.pread(output, os.fstat(output).st_size, 0).decode()

    def send_signal(self, number: int) -> None:
        """A signal to it alone, where it still runs."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        """The signal that cannot be caught."""
        self.send_signal(signal.SIGKILL)

    def _look(self, timeout: float | None) -> int | None:
        # Several threads may wait for one command: one of them hears of its end, and closes the way.
        with suppress(OSError, ValueError):
            if self.returncode is None:
                select.select([self._reported], [], [], timeout)
        with self._hearing:
            if self.returncode is None and select.select([self._reported], [], [], 0.0)[0]:
                code = self._hear()
                os.close(self._reported)
                out, err = (_all_of(output) for output in self._outputs)
                self._printed, self.returncode = (out, err), code
        return self.returncode

    def _hear(self) -> int:
        reported = os.read(self._reported, NUMBER.size)
        if len(reported) < NUMBER.size:
            raise ChildProcessError("who started the command is gone")
        return int(NUMBER.unpack(reported)[0])


def _all_of(output: int) -> str:
    with open(output, encoding="utf-8") as file:
        file.seek(0)
        return file.read()


@functools.cache
def _server(preload: Path | None) -> socket.socket:
    """The way to a server, which ends with the last process that has one; `preload` is a library that comes first."""
    run = os.environ.get(RUN_OF_TESTS, secrets.token_hex(16)) if preload is None else secrets.token_hex(16)
    address = str(Path(tempfile.gettempdir()) / f"fluxbench-{run}")
    near = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listening:
        is_first = _is_first(listening, address)
        connect(near, address)
        if is_first:
            words = [sys.executable, "-m", "tests.support.forking", str(listening.fileno())]
            around = {**os.environ, "LD_PRELOAD": str(preload)} if preload else None
            nothing, ways = subprocess.DEVNULL, [listening.fileno()]
            process = subprocess.Popen(words, cwd=ROOT, env=around, stdin=nothing, stdout=nothing, pass_fds=ways)
            atexit.register(process.wait)
    atexit.register(near.close)
    return near


def _is_first(listening: socket.socket, address: str) -> bool:
    """Whether nobody listens there yet; then this socket does, for this user alone."""
    mask = os.umask(0o077)
    try:
        listening.bind(address)
    except OSError as error:
        if error.errno != errno.EADDRINUSE:
            raise
        return False
    finally:
        os.umask(mask)
    listening.listen(64)
    return True


def connect(near: socket.socket, address: str, timeout_s: float = 10.0) -> None:
    """Connect, where another process may just have bound its socket and not listen yet."""
    deadline = time.monotonic() + timeout_s
    while True:
        try:
            return near.connect(address)
        except ConnectionRefusedError:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.01)


def serve(listening: socket.socket) -> None:
    """Fork a command for each request; returns in the forked command alone, and ends when nobody is left to ask."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for who asks
    ways: list[socket.socket] = []
    while True:
        for way in select.select([listening, *ways], [], [])[0]:
            if way is listening:
                ways.append(listening.accept()[0])
                continue
            request, descriptors = b"", list[int]()
            with suppress(ConnectionError):
                request, descriptors, _, _ = socket.recv_fds(way, LONGEST_REQUEST, 3)
            if request and os.fork() == 0:
                for other in (listening, *ways):
                    other.close()
                return guard(json.loads(request), *descriptors)
            for descriptor in descriptors:
                os.close(descriptor)
            if not request:
                ways.remove(way)
                way.close()
        with suppress(ChildProcessError):
            while os.waitpid(-1, os.WNOHANG)[0]:
                pass
        if not ways:
            Path(listening.getsockname()).unlink()
            raise SystemExit


def guard(request: dict[str, object], out: int, err: int, telling: int) -> None:
    """Fork the command, in which this returns; tell its pid and, when it has ended, its exit code."""
    pid = os.fork()
    if pid == 0:
        os.close(telling)
        return become(request, out, err)
    for output in (out, err):
        os.close(output)
    os.write(telling, NUMBER.pack(pid))
    _, status = os.waitpid(pid, 0)
    os.write(telling, NUMBER.pack(os.waitstatus_to_exitcode(status)))
    os._exit(0)


def become(request: dict[str, object], out: int, err: int) -> None:
    """Put this process into the state in which a new interpreter would be for this command.

    It gets a session of its own: Linux shares the processors among sessions first, so that a command beside busy
    tests in theirs is woken late by half a second, and one in its own is not (docs/robustness.md).
    """
    os.setsid()
    signal.signal(signal.SIGINT, signal.default_int_handler)
    for source, target in ((out, 1), (err, 2)):
        os.dup2(source, target)
        os.close(source)
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]
    words, cwd, environment = request["words"], request["cwd"], request["environment"]
    assert isinstance(words, list)
    assert isinstance(cwd, str)
    assert isinstance(environment, dict)
    os.chdir(cwd)
    os.environ.clear()
    os.environ.update(environment)
    sys.argv = ["fluxbench", *words]


def import_everything() -> None:
    """What commands import, as far as it starts no threads."""
    from importlib.metadata import entry_points

    from numba.core.registry import cpu_target

    plugins = [entry.module for kind in PLUGINS for entry in entry_points(group=f"fluxbench.{kind}")]
    for module in [*(f"orchestrator.interface.cli.{name}" for name in COMMANDS), *plugins, *LIBRARIES]:
        if not module.startswith(WITH_THREADS):
            importlib.import_module(module)
    # What numba itself loads at the first kernel.
    cpu_target.typing_context.refresh()
    cpu_target.target_context.refresh()
    threads = [task.read_text().strip() for task in Path("/proc/self/task").glob("*/comm")]
    assert len([name for name in threads if name != FORKS_WELL]) == 1, threads
    gc.collect()
    gc.freeze()


if __name__ == "__main__":
    import_everything()
    with socket.socket(fileno=int(sys.argv[1])) as listening:
        serve(listening)
    from orchestrator.interface.cli import main

    main()

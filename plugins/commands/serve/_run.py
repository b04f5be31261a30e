"""The page's run: its process, its output, and the messages to it.

The process is never killed, as asyncio's own subprocesses are with their loop, since a killed run does not ramp down.
If this process ends, the run finds its pipe closed and stops by itself.
"""

from __future__ import annotations

import asyncio
import json
import signal
import subprocess
import sys
from collections.abc import AsyncIterator, Coroutine, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from protocols import FluxbenchError

PROGRAM = (sys.executable, "-P", "-c", "from orchestrator.interface.cli import main; main()")
"""`fluxbench`, without modules of the folder in which it is started."""
ENDING_STATES = ("stopping", "finished", "faulted", "aborted")
MAX_LINE_BYTES = 1 << 24


class NotNowError(FluxbenchError):
    """The request conflicts with the active run."""


@dataclass(frozen=True)
class Pace:
    """Periods of polling and of keepalives, and timeouts of a run's end [s]."""

    poll_period_s: float = 0.1
    keepalive_period_s: float = 1.0
    stop_timeout_s: float = 1.0
    output_timeout_s: float = 2.0


class RunOfThePage:
    """Starts and monitors runs, one at a time, and forwards answers and stops.

    Parameters
    ----------
    folder : Path
        Working folder of runs, which are written to its ``runs/``.
    """

    def __init__(self, folder: Path, pace: Pace | None = None) -> None:
        self._folder, self._pace = folder, pace or Pace()
        self._process: subprocess.Popen[bytes] | None = None
        self._messages_in: asyncio.WriteTransport | None = None
        self._tasks: set[asyncio.Task[None]] = set()
        self._answered = 0
        self._changed = asyncio.Condition()
        self._is_closing = self._is_closed = False
        self._view: dict[str, Any] = {
            "going": False, "stopping": False, "problem": "", "subject": "", "picture": None,
        }  # fmt: skip

    @property
    def is_going(self) -> bool:
        return bool(self._view["going"])

    async def views(self) -> AsyncIterator[dict[str, Any]]:
        """The present state and each change until the server closes; a slow reader misses some."""
        last: dict[str, Any] | None = None
        while not self._is_closed:
            if last is self._view:
                async with self._changed:
                    with suppress(TimeoutError):  # repeated, to detect a closed browser
                        await asyncio.wait_for(self._changed.wait(), 10.0)
            last = self._view
            yield last

    async def start(self, words: Sequence[str], subject: str) -> None:
        """Start `fluxbench` with these arguments; raises `NotNowError` while another run is active.

        `subject` says what is started, for the page to show until the run itself does.
        """
        if self.is_going or self._is_closing:
            raise NotNowError("a run is already active; only one is possible at a time")
        self._answered = 0
        self._process = subprocess.Popen(
            [*PROGRAM, *words, "--remote=page"],
            cwd=self._folder,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            bufsize=0,
            start_new_session=True,  # the terminal's Ctrl-C and Ctrl-Z must reach the server only
        )
        begun = {"going": True, "stopping": False, "problem": "", "subject": subject, "picture": None}
        self._view = self._view | begun  # before the first await
        await self._show()
        self._keep(self._follow(self._process))

    async def answer(self, number: int, answer: str) -> None:
        """Forward the answer to the open question; raises `NotNowError` where it is another one, or none is open."""
        question = (self._view["picture"] or {}).get("question")
        if not self.is_going or question is None or question["number"] != number or self._answered >= number:
            raise NotNowError("this question is no longer open")
        self._answered = number
        self._send({"answer": answer, "question": question["prompt"]})

    async def stop(self, reason: str) -> None:
        """Stop an active run as Ctrl-C does."""
        if not self.is_going or self._process is None:
            return
        self._send({"stop": reason})
        await self._show(stopping=True)
        self._keep(self._insist(self._process))

    async def close(self, reason: str, timeout_s: float = 30.0) -> None:
        """Refuse new runs, stop an active one, and wait for its end up to `timeout_s`."""
        self._is_closing = True
        if self.is_going:
            await self.stop(reason)
            with suppress(TimeoutError):
                await asyncio.wait_for(self._until_ended(), timeout_s)
        self._is_closed = True
        await self._show()

    async def _until_ended(self) -> None:
        async with self._changed:
            await self._changed.wait_for(lambda: not self.is_going)

    async def _show(self, **changes: Any) -> None:
        async with self._changed:
            self._view = self._view | changes
            self._changed.notify_all()

    def _send(self, message: dict[str, Any]) -> None:
        if self._messages_in is not None and not self._messages_in.is_closing():
            self._messages_in.write(json.dumps(message).encode() + b"\n")

    async def _insist(self, process: subprocess.Popen[bytes]) -> None:
        """Signal a run that ignores messages because it is starting or hangs."""
        await asyncio.sleep(self._pace.stop_timeout_s)
        if process.poll() is None and (self._view["picture"] or {}).get("state") not in ENDING_STATES:
            process.send_signal(signal.SIGINT)

    async def _follow(self, process: subprocess.Popen[bytes]) -> None:
        """Monitor a process from its first line to its exit code."""
        self._messages_in, _ = await asyncio.get_running_loop().connect_write_pipe(asyncio.BaseProtocol, process.stdin)
        shown = asyncio.ensure_future(self._read_pictures(await _reader(process.stdout)))
        errors_read = asyncio.ensure_future((await _reader(process.stderr)).read())
        looks = 0
        while process.poll() is None:
            if looks % round(self._pace.keepalive_period_s / self._pace.poll_period_s) == 0:
                self._send({})
            looks += 1
            await asyncio.sleep(self._pace.poll_period_s)
        await asyncio.wait({shown, errors_read}, timeout=self._pace.output_timeout_s)
        self._messages_in.close()
        errors = errors_read.result().decode("utf-8", "replace").strip() if errors_read.done() else ""
        code = process.returncode
        problem = errors.splitlines()[-1].removeprefix("fluxbench: ") if errors and code else ""
        await self._show(going=False, stopping=False, problem=problem or ("" if code == 0 else f"ended with {code}"))

    async def _read_pictures(self, output: asyncio.StreamReader) -> None:
        while line := await output.readline():
            with suppress(ValueError, RecursionError):  # output of a plugin
                picture = json.loads(line)
                if isinstance(picture, dict):
                    await self._show(picture=picture)

    def _keep(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.ensure_future(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)


async def _reader(pipe: IO[bytes] | None) -> asyncio.StreamReader:
    reader = asyncio.StreamReader(limit=MAX_LINE_BYTES)
    await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), pipe)
    return reader


async def checked(words: Sequence[str], folder: Path) -> tuple[int, str, str]:
    """Run a command that energises nothing; returns exit code, output and errors."""
    pipe, nothing = asyncio.subprocess.PIPE, asyncio.subprocess.DEVNULL
    process = await asyncio.create_subprocess_exec(
        *PROGRAM, *words, cwd=folder, stdin=nothing, stdout=pipe, stderr=pipe, start_new_session=True
    )
    out, err = await process.communicate()
    return process.returncode or 0, out.decode("utf-8", "replace"), err.decode("utf-8", "replace").strip()

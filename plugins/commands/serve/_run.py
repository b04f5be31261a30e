"""The page's one run: a process of its own, its output, and the messages to it.

Nothing here ends that process: asyncio's own subprocesses are killed with their loop, and a killed run ramps nothing
down. Where this process is gone the run finds its pipe closed, and stops by itself.
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
"""`fluxbench`, whatever stands in the folder that it is started in."""
ENDING_STATES = ("stopping", "finished", "faulted", "aborted")
MAX_LINE_BYTES = 1 << 24


class NotNowError(FluxbenchError):
    """The request conflicts with the run under way."""


@dataclass(frozen=True)
class Pace:
    """Period of looking at a run and of its keepalives; how long it may take to stop [s]."""

    poll_period_s: float = 0.1
    keepalive_period_s: float = 1.0
    stop_timeout_s: float = 1.0
    output_timeout_s: float = 2.0


class RunOfThePage:
    """Starts runs, one at a time, follows them, and hands on answers and stops.

    Parameters
    ----------
    folder : Path
        Where runs are started; ``runs/`` is made there.
    """

    def __init__(self, folder: Path, pace: Pace | None = None) -> None:
        self._folder, self._pace = folder, pace or Pace()
        self._process: subprocess.Popen[bytes] | None = None
        self._ear: asyncio.WriteTransport | None = None
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
        """How it stands, now and whenever that has changed, until the server closes; whoever is slow misses some."""
        last: dict[str, Any] | None = None
        while not self._is_closed:
            if last is self._view:
                async with self._changed:
                    with suppress(TimeoutError):  # sent again now and then: a browser may have gone
                        await asyncio.wait_for(self._changed.wait(), 10.0)
            last = self._view
            yield last

    async def start(self, words: Sequence[str], subject: str) -> None:
        """Start `fluxbench` with these words; raises `NotNowError` while another run is going.

        `subject` says what is started, for the page to show until the run itself does.
        """
        if self.is_going or self._is_closing:
            raise NotNowError("a run is going already, and there is one at a time")
        self._answered = 0
        self._process = subprocess.Popen(
            [*PROGRAM, *words, "--remote=page"],
            cwd=self._folder,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            bufsize=0,
            start_new_session=True,  # a terminal's Ctrl-C and Ctrl-Z are for the server
        )
        begun = {"going": True, "stopping": False, "problem": "", "subject": subject, "picture": None}
        self._view = self._view | begun  # before anything is waited for
        await self._show()
        self._keep(self._follow(self._process))

    async def answer(self, number: int, answer: str) -> None:
        """Hand on the answer to the open question; raises `NotNowError` where that is another one, or none."""
        question = (self._view["picture"] or {}).get("question")
        if not self.is_going or question is None or question["number"] != number or self._answered >= number:
            raise NotNowError("this question is not open any more")
        self._answered = number
        self._send({"answer": answer, "question": question["prompt"]})

    async def stop(self, reason: str) -> None:
        """End the run as Ctrl-C does; nothing where none is going."""
        if not self.is_going or self._process is None:
            return
        self._send({"stop": reason})
        await self._show(stopping=True)
        self._keep(self._insist(self._process))

    async def close(self, reason: str, timeout_s: float = 30.0) -> None:
        """Start nothing any more, stop what is going, and wait for its end as long as that is sensible."""
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
        if self._ear is not None and not self._ear.is_closing():
            self._ear.write(json.dumps(message).encode() + b"\n")

    async def _insist(self, process: subprocess.Popen[bytes]) -> None:
        """Signal a run that ignores messages: while it starts, or hangs."""
        await asyncio.sleep(self._pace.stop_timeout_s)
        if process.poll() is None and (self._view["picture"] or {}).get("state") not in ENDING_STATES:
            process.send_signal(signal.SIGINT)

    async def _follow(self, process: subprocess.Popen[bytes]) -> None:
        """From the first line to the exit code."""
        self._ear, _ = await asyncio.get_running_loop().connect_write_pipe(asyncio.BaseProtocol, process.stdin)
        shown = asyncio.ensure_future(self._read_pictures(await _reader(process.stdout)))
        complained = asyncio.ensure_future((await _reader(process.stderr)).read())
        looks = 0
        while process.poll() is None:
            if looks % round(self._pace.keepalive_period_s / self._pace.poll_period_s) == 0:
                self._send({})
            looks += 1
            await asyncio.sleep(self._pace.poll_period_s)
        await asyncio.wait({shown, complained}, timeout=self._pace.output_timeout_s)
        self._ear.close()
        errors = complained.result().decode("utf-8", "replace").strip() if complained.done() else ""
        code = process.returncode
        problem = errors.splitlines()[-1].removeprefix("fluxbench: ") if errors and code else ""
        await self._show(going=False, stopping=False, problem=problem or ("" if code == 0 else f"ended with {code}"))

    async def _read_pictures(self, output: asyncio.StreamReader) -> None:
        while line := await output.readline():
            with suppress(ValueError, RecursionError):  # a plugin's own words
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
    """Run a command that energises nothing to its end: its exit code, what it printed, and what was wrong."""
    pipe, nothing = asyncio.subprocess.PIPE, asyncio.subprocess.DEVNULL
    process = await asyncio.create_subprocess_exec(
        *PROGRAM, *words, cwd=folder, stdin=nothing, stdout=pipe, stderr=pipe, start_new_session=True
    )
    out, err = await process.communicate()
    return process.returncode or 0, out.decode("utf-8", "replace"), err.decode("utf-8", "replace").strip()

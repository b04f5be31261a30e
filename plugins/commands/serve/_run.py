"""The page's run: its process, its output, and the messages to it.

The process is never killed, as asyncio's own subprocesses are with their loop, since a killed run does not ramp down.
If this process ends, the run finds its pipe closed and stops by itself.
"""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
from collections.abc import Coroutine, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from orchestrator.operating_system.processes import interrupt, open_process, own_group
from plugins.commands.serve._viewers import Viewers
from protocols import FluxbenchError

PROGRAM = (sys.executable, "-P", "-c", "from orchestrator.interface.cli import main; main()")
"""`fluxbench`, without modules of the folder in which it is started."""
ENDING_STATES = ("stopping", "finished", "faulted", "aborted")
MAX_LINE_BYTES = 1 << 24
MAX_ERROR_BYTES = 1 << 16
"""Of the end of what a process writes to standard error."""
MAX_CHECKS = 4
CHECK_TIMEOUT_S = 120.0


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
        self._has_ended = asyncio.Event()
        self._is_closing = False
        self._view: dict[str, Any] = {
            "going": False, "stopping": False, "problem": "", "subject": "", "picture": None,
        }  # fmt: skip
        self.viewers = Viewers(self._view)

    @property
    def is_going(self) -> bool:
        return bool(self._view["going"])

    def start(self, words: Sequence[str], subject: str) -> None:
        """Start `fluxbench` with these arguments; raises `NotNowError` while another run is active.

        `subject` says what is started, for the page to show until the run itself does.
        """
        if self.is_going or self._is_closing:
            raise NotNowError("a run is already active; only one is possible at a time")
        try:
            process = open_process(
                [*PROGRAM, *words, "--remote=page"],
                cwd=self._folder,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                **own_group(),  # the terminal's Ctrl-C and Ctrl-Z must reach the server only
            )
        except OSError as error:
            raise NotNowError(f"the run's process cannot be started: {error.strerror or error}") from None
        self._process, self._answered = process, 0
        self._has_ended.clear()
        self._show(going=True, stopping=False, problem="", subject=subject, picture=None)
        self._keep(self._follow(process))

    def answer(self, number: int, answer: str) -> None:
        """Forward the answer to the open question; raises `NotNowError` where it is another one, or none is open."""
        question = (self._view["picture"] or {}).get("question")
        if not self.is_going or question is None or question["number"] != number or self._answered >= number:
            raise NotNowError("this question is no longer open")
        self._answered = number
        self._send({"answer": answer, "question": question["prompt"]})

    def stop(self, reason: str) -> None:
        """Stop an active run as Ctrl-C does."""
        if not self.is_going or self._process is None:
            return
        self._send({"stop": reason})
        self._show(stopping=True)
        self._keep(self._insist(self._process))

    async def close(self, reason: str, timeout_s: float = 30.0) -> None:
        """Refuse new runs, stop an active one, and wait for its end up to `timeout_s`."""
        self._is_closing = True
        if self.is_going:
            self.stop(reason)
            with suppress(TimeoutError):
                async with asyncio.timeout(timeout_s):
                    await self._has_ended.wait()
        self.viewers.close()

    def _show(self, **changes: Any) -> None:
        self._view = self._view | changes
        self.viewers.publish(self._view)

    def _send(self, message: dict[str, Any]) -> None:
        if self._messages_in is not None and not self._messages_in.is_closing():
            self._messages_in.write(json.dumps(message).encode() + b"\n")

    async def _insist(self, process: subprocess.Popen[bytes]) -> None:
        """Signal a run that ignores messages because it is starting or hangs."""
        await asyncio.sleep(self._pace.stop_timeout_s)
        if process.poll() is None and (self._view["picture"] or {}).get("state") not in ENDING_STATES:
            interrupt(process)

    async def _follow(self, process: subprocess.Popen[bytes]) -> None:
        """Monitor a process from its first line to its exit code."""
        try:
            errors = await self._exchange(process)
        except OSError as error:
            errors = f"the server has lost the run's output: {error.strerror or error}"
        while (code := process.poll()) is None:
            await asyncio.sleep(self._pace.poll_period_s)
        problem = errors.splitlines()[-1].removeprefix("fluxbench: ") if errors and code else ""
        self._show(going=False, stopping=False, problem=problem or ("" if code == 0 else f"ended with {code}"))
        self._has_ended.set()

    async def _exchange(self, process: subprocess.Popen[bytes]) -> str:
        """Show a process's output and send it keepalives until it ends; returns the end of its errors."""
        loop = asyncio.get_running_loop()
        pipes = (process.stdin, process.stdout, process.stderr)
        output, errors = (asyncio.StreamReader(limit=MAX_LINE_BYTES) for _ in range(2))
        transports: list[asyncio.BaseTransport] = []
        try:
            self._messages_in, _ = await loop.connect_write_pipe(asyncio.BaseProtocol, process.stdin)
            transports.append(self._messages_in)
            for reader, pipe in ((output, process.stdout), (errors, process.stderr)):
                transport, _ = await loop.connect_read_pipe(partial(asyncio.StreamReaderProtocol, reader), pipe)
                transports.append(transport)
            return await self._exchange_lines(process, output, errors)
        finally:  # without its pipes an active run stops by itself
            for opened in transports:
                opened.close()
            for pipe in pipes:
                if pipe is not None:
                    pipe.close()

    async def _exchange_lines(
        self, process: subprocess.Popen[bytes], output: asyncio.StreamReader, errors: asyncio.StreamReader
    ) -> str:
        shown = asyncio.ensure_future(self._read_pictures(output))
        errors_read = asyncio.ensure_future(end_of(errors))
        looks = 0
        while process.poll() is None:
            if looks % round(self._pace.keepalive_period_s / self._pace.poll_period_s) == 0:
                self._send({})
            looks += 1
            await asyncio.sleep(self._pace.poll_period_s)
        await asyncio.wait({shown, errors_read}, timeout=self._pace.output_timeout_s)
        shown.cancel()
        return errors_read.result().decode("utf-8", "replace").strip() if errors_read.done() else ""

    async def _read_pictures(self, output: asyncio.StreamReader) -> None:
        while True:
            try:
                line = await output.readline()
                picture = json.loads(line) if line else None
            except (ValueError, RecursionError):  # output of a plugin, or longer than any picture
                continue
            if not line:
                return
            if isinstance(picture, dict):
                self._show(picture=picture)

    def _keep(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.ensure_future(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)


async def end_of(output: asyncio.StreamReader) -> bytes:
    """The last bytes of an output."""
    end = b""
    while data := await output.read(MAX_ERROR_BYTES):
        end = (end + data)[-MAX_ERROR_BYTES:]
    return end


class Checks:
    """Commands that energise nothing; a few at a time."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._active = folder, 0

    async def run(self, words: Sequence[str]) -> tuple[int, str, str]:
        """Exit code, output and errors of a command; raises `NotNowError` where too many are active."""
        if self._active >= MAX_CHECKS:
            raise NotNowError(f"{MAX_CHECKS} checks are active; wait for one of them")
        self._active += 1
        try:
            return await _checked(words, self._folder)
        finally:
            self._active -= 1


async def _checked(words: Sequence[str], folder: Path) -> tuple[int, str, str]:
    pipe, nothing = asyncio.subprocess.PIPE, asyncio.subprocess.DEVNULL
    try:
        process = await asyncio.create_subprocess_exec(
            *PROGRAM, *words, cwd=folder, stdin=nothing, stdout=pipe, stderr=pipe, **own_group()
        )
    except OSError as error:
        raise NotNowError(f"the check's process cannot be started: {error.strerror or error}") from None
    try:
        async with asyncio.timeout(CHECK_TIMEOUT_S):
            out, err = await process.communicate()
    except TimeoutError:
        raise NotNowError(f"the check has not ended within {CHECK_TIMEOUT_S:g} s") from None
    finally:
        if process.returncode is None:
            process.kill()
    return process.returncode or 0, out.decode("utf-8", "replace"), err.decode("utf-8", "replace").strip()

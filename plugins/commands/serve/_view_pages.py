"""Pages of the viewer, opened from the shelf: each a process of its own that ends with the server."""

from __future__ import annotations

import asyncio
import signal
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from plugins.commands.serve._run import PROGRAM, NotNowError, end_of
from plugins.streams.rerun._viewer import tied

MAX_PAGES = 3
"""A further one ends the oldest: each may hold gigabytes."""
START_TIMEOUT_S = 60.0


@dataclass(frozen=True)
class _OpenPage:
    process: asyncio.subprocess.Process
    address: str
    errors: asyncio.Future[bytes]


class ViewPages:
    """Viewers that serve a page each."""

    def __init__(self) -> None:
        self._open: dict[Path, _OpenPage] = {}
        self._opening = asyncio.Lock()

    async def address_of(self, run: Path) -> str:
        """The address of the page with a run, which is opened where it is not yet.

        Raises
        ------
        NotNowError
            The viewer does not start.
        """
        async with self._opening:
            page = self._open.pop(run, None)
            if page is None or page.process.returncode is not None:
                while len(self._open) >= MAX_PAGES:
                    _end(self._open.pop(next(iter(self._open))).process)
                page = await _started(run)
            self._open[run] = page
            return page.address

    def close(self) -> None:
        """End them all."""
        for page in self._open.values():
            _end(page.process)
        self._open.clear()


async def _started(run: Path) -> _OpenPage:
    pipe, nothing = asyncio.subprocess.PIPE, asyncio.subprocess.DEVNULL
    words = tied([*PROGRAM, "view", "--web", "--", str(run)])
    try:
        process = await asyncio.create_subprocess_exec(
            *words, stdin=nothing, stdout=pipe, stderr=pipe, start_new_session=True
        )
    except OSError as error:
        raise NotNowError(f"the viewer cannot be started: {error.strerror or error}") from None
    assert process.stdout is not None  # both are pipes
    assert process.stderr is not None
    errors = asyncio.ensure_future(end_of(process.stderr))  # read all the time, so that the pipe is never full
    address = ""
    try:
        async with asyncio.timeout(START_TIMEOUT_S):
            address = (await process.stdout.readline()).decode("utf-8", "replace").strip()
            if address:
                return _OpenPage(process, address, errors)
            problem = (await errors).decode("utf-8", "replace").strip().splitlines()
    except TimeoutError:
        raise NotNowError(f"the viewer has not started within {START_TIMEOUT_S:g} s") from None
    finally:
        if not address:
            _end(process)
    raise NotNowError(problem[-1].removeprefix("fluxbench: ") if problem else "the viewer does not start")


def _end(process: asyncio.subprocess.Process) -> None:
    with suppress(ProcessLookupError):
        process.send_signal(signal.SIGTERM)

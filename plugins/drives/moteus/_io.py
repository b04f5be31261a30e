"""The official library's event loop in a thread of its own, and its errors as the project's. Knows no registers."""

from __future__ import annotations

import asyncio
import concurrent.futures
import threading
import time
from collections.abc import Awaitable, Callable, Coroutine
from contextlib import suppress
from typing import Any, TypeVar

from plugins.drives.moteus._bounds import BOUNDS
from protocols import DriveFault, FaultCause, FluxbenchError

T = TypeVar("T")


async def within(work: Awaitable[T], timeout_s: float) -> T:
    """What some work comes to in this time; raises `TimeoutError` then, whatever the work does about its end.

    `asyncio.wait_for` waits until the work has ended, which a library that catches its cancellation never does.
    """
    task = asyncio.ensure_future(work)
    try:
        done, _ = await asyncio.wait({task}, timeout=timeout_s)
    finally:
        task.cancel()  # of no effect where it has ended
    if not done:
        raise TimeoutError
    return task.result()


class Io:
    """Owner of the thread; begun by making it, ended by `close`.

    Parameters
    ----------
    where : str
        The board's address, for messages.
    """

    def __init__(self, where: str) -> None:
        self._where = where
        self.lost: DriveFault | None = None
        """Why nothing can be sent any more."""
        self._beat: asyncio.Task[None] | None = None
        self._loop = asyncio.new_event_loop()
        self._loop.set_exception_handler(self._broken)
        self._turned_s = time.monotonic()
        self._loop.call_soon(self._turn)
        self._is_left = False
        self._thread = threading.Thread(target=self._run, name="moteus", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        self._loop.run_forever()
        if self._is_left:
            self._end(lambda: None)

    def _turn(self) -> None:
        """Note that the loop turns, again and again."""
        self._turned_s = time.monotonic()
        self._loop.call_later(BOUNDS.poll_period_s, self._turn)

    def check(self) -> None:
        """Raises `DriveFault` (link_lost) once the link is lost; there is no way back."""
        if self.lost is None and time.monotonic() - self._turned_s > BOUNDS.max_stall_s:
            self._lose(f"the library has blocked for {BOUNDS.max_stall_s:g} s")
        if self.lost is not None:
            raise DriveFault(self.lost.cause, self.lost.detail)

    def call(self, work: Callable[[], Coroutine[Any, Any, T]], timeout_s: float) -> T:
        """Run a coroutine to its end and hand back its result.

        Raises
        ------
        DriveFault
            With cause link_lost, whatever the library raised; the project's own errors pass.
        """
        self.check()

        async def timed() -> T:
            return await within(work(), timeout_s)

        future = self.start(timed)
        self.wait(future, timeout_s + BOUNDS.loop_timeout_s)
        return self.result(future)

    def start(self, work: Callable[[], Coroutine[Any, Any, T]]) -> concurrent.futures.Future[T]:
        """Begin a coroutine; its end is fetched by `result`."""
        self.check()
        return asyncio.run_coroutine_threadsafe(work(), self._loop)

    def wait(self, future: concurrent.futures.Future[T], timeout_s: float) -> bool:
        """Whether the coroutine came to its end, or the link was lost, within this time."""
        deadline = time.monotonic() + timeout_s
        while not future.done() and self.lost is None:
            left_s = deadline - time.monotonic()
            if left_s <= 0.0:
                self.check()
                return False
            concurrent.futures.wait([future], min(left_s, BOUNDS.poll_period_s))
        return True

    def result(self, future: concurrent.futures.Future[T]) -> T:
        """What a coroutine came to; a loop that is dead never brings it to an end."""
        if not future.done():
            future.cancel()
            self.check()
            raise self._lose("no answer any more")
        try:
            return future.result()
        except FluxbenchError as error:
            if isinstance(error, DriveFault) and error.cause is FaultCause.LINK_LOST:
                self.lost = error
            raise
        except concurrent.futures.CancelledError as error:
            raise self._lose("given up") from error
        except Exception as error:  # the library raises what its parts do: there is no common base
            raise self._lose(error) from error

    def soon(self, work: Callable[[], Awaitable[None]]) -> None:
        """Run a coroutine when there is time for it; dropped while the one before is under way. Never raises."""
        if self.lost is None:
            with suppress(RuntimeError):  # the loop was closed in this moment
                self._loop.call_soon_threadsafe(self._start_beat, work)

    def _start_beat(self, work: Callable[[], Awaitable[None]]) -> None:
        if self._beat is None or self._beat.done():
            self._beat = self._loop.create_task(self._beaten(work))

    async def _beaten(self, work: Callable[[], Awaitable[None]]) -> None:
        try:
            await work()
        except Exception as error:  # as in `result`
            self._lose(error)

    def _broken(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """A callback of the library raised: its reader, when the port is gone. It would be called for ever."""
        if "handle" not in context:
            return  # a task's own end, which its owner knows
        self._lose(context.get("exception") or str(context.get("message")))
        loop.stop()

    def _lose(self, why: BaseException | str) -> DriveFault:
        reason = str(why) or type(why).__name__
        fault = DriveFault(FaultCause.LINK_LOST, f"{self._where}: {reason.splitlines()[0]}")
        self.lost = self.lost or fault
        return fault

    def close(self, release: Callable[[], None]) -> None:
        """Stop the thread, let go of what runs on it, and of the transport."""
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(BOUNDS.loop_timeout_s)
        if self._thread.is_alive():
            # A call of the library blocks the thread: it is left, and the port taken from it. It ends after that call.
            self._is_left = True
            with suppress(Exception):
                release()
            return
        self._end(release)

    def _end(self, release: Callable[[], None]) -> None:
        """Let go of all that the loop has, and close it."""
        self._loop.set_exception_handler(lambda loop, context: None)
        self._loop.call_soon(self._loop.stop)
        try:
            self._loop.run_forever()  # another caller's stop takes effect here
            self._loop.run_until_complete(_let_go(release))
        finally:
            self._loop.close()


async def _let_go(release: Callable[[], None]) -> None:
    release()
    tasks = [task for task in asyncio.all_tasks() if task is not asyncio.current_task()]
    for task in tasks:
        task.cancel()
    if tasks:
        await asyncio.wait(tasks, timeout=BOUNDS.loop_timeout_s)

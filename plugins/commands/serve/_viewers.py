"""The open event streams of the page: each has a slot of its own, and nothing waits for any of them.

An event is the whole state, so that a slot holds one: a slow reader misses the states in between. There is no lock and
no common queue, since a browser that closes cancels its stream at any instant, and repeatedly.
"""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import AsyncIterator
from typing import Any

MAX_STREAMS = 256
MIN_EVENT_PERIOD_S = 0.1
KEEPALIVE_PERIOD_S = 1.0
FIRST_LINE = b"retry: 1000\n\n"
"""A browser's delay before it opens a stream again [ms]."""


class Viewers:
    """Distributes states to the open streams.

    Parameters
    ----------
    view : dict
        First state.
    max_streams : int
        A further stream ends the oldest one, whose browser opens another.
    """

    def __init__(self, view: dict[str, Any], max_streams: int = MAX_STREAMS) -> None:
        self._streams: dict[_Slot, None] = {}
        self._max_streams, self._is_closed = max_streams, False
        self._changed_s = time.monotonic()
        self.publish(view)

    def __len__(self) -> int:
        return len(self._streams)

    def publish(self, view: dict[str, Any]) -> None:
        """Put a state in each slot."""
        self._event, self._changed_s = f"data: {json.dumps(view)}\n\n".encode(), time.monotonic()
        for slot in self._streams:
            slot.has_news.set()

    def close(self) -> None:
        """End all streams after the present state."""
        self._is_closed = True
        for slot in self._streams:
            slot.end()

    async def events(self) -> AsyncIterator[bytes]:
        """The present state and each change, as server-sent events, with keepalives between."""
        slot = _Slot()
        self._streams[slot] = None
        if self._is_closed:
            slot.end()
        if len(self._streams) > self._max_streams:
            oldest = next(iter(self._streams))
            del self._streams[oldest]
            oldest.end()
        try:
            yield FIRST_LINE + self._event
            while True:
                await asyncio.sleep(MIN_EVENT_PERIOD_S)
                try:
                    async with asyncio.timeout(KEEPALIVE_PERIOD_S):
                        await slot.has_news.wait()
                except TimeoutError:
                    yield self._keepalive()
                    continue
                slot.has_news.clear()
                yield self._event
                if slot.is_ending and not slot.has_news.is_set():
                    return
        finally:
            self._streams.pop(slot, None)

    def _keepalive(self) -> bytes:
        """An event of another name: the server is alive, and the age of the state."""
        age_s = round(time.monotonic() - self._changed_s, 1)
        return f"event: alive\ndata: {json.dumps({'age_s': age_s})}\n\n".encode()


class _Slot:
    """What one stream has not been sent yet."""

    def __init__(self) -> None:
        self.has_news, self.is_ending = asyncio.Event(), False

    def end(self) -> None:
        """End the stream after one more event."""
        self.is_ending = True
        self.has_news.set()

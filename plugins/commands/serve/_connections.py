"""Connections that do not wait for their clients for ever, and of which there are not too many.

uvicorn itself keeps a connection open on which no request comes, and a response that is not read.
"""

from __future__ import annotations

import asyncio
import time

from uvicorn.protocols.http.h11_impl import H11Protocol

MAX_CONNECTIONS = 512
"""Half of the descriptors that a process usually may open."""
CLIENT_TIMEOUT_S = 10.0
"""Time for a client to send a whole request, and to read what was written."""


class Connection(H11Protocol):
    """A connection that is dropped when its client is overdue, or is the idlest of too many."""

    max_connections = MAX_CONNECTIONS
    client_timeout_s = CLIENT_TIMEOUT_S

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        self._waiting_since_s = time.monotonic()
        self._unread_since_s: float | None = None
        super().connection_made(transport)
        if len(self.connections) > self.max_connections:
            waiting = [one for one in self.connections if isinstance(one, Connection) and one.waits_for_request]
            min(waiting, key=lambda one: one._waiting_since_s, default=self).drop()

    @property
    def waits_for_request(self) -> bool:
        """Whether no whole request is being answered."""
        return self.cycle is None or self.cycle.response_complete or self.cycle.more_body

    def drop_if_overdue(self, now_s: float) -> None:
        """Close the connection where its client lets wait, for a request or to read the response."""
        since_s = self._waiting_since_s if self.waits_for_request else self._unread_since_s
        if since_s is not None and now_s - since_s > self.client_timeout_s:
            self.drop()

    def drop(self) -> None:
        """Close the connection without waiting until what was written is read."""
        self.connections.discard(self)
        self.transport.abort()

    def on_response_complete(self) -> None:
        self._waiting_since_s = time.monotonic()
        super().on_response_complete()

    def pause_writing(self) -> None:
        self._unread_since_s = time.monotonic()
        super().pause_writing()

    def resume_writing(self) -> None:
        self._unread_since_s = None
        super().resume_writing()

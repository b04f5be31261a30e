"""The device's send queue: ordered by urgency, with the rate and the losses of a real line."""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Generic, TypeVar

from plugins.commands.emulator._bounds import BOUNDS
from plugins.commands.emulator._ports import Port, Unit
from plugins.wire import Frame

T = TypeVar("T")


@dataclass(frozen=True)
class Losses:
    """Probabilities of losses per frame, in each direction."""

    drop: float = 0.0
    duplicate: float = 0.0
    reorder: float = 0.0
    corrupt: float = 0.0

    def __bool__(self) -> bool:
        return any((self.drop, self.duplicate, self.reorder, self.corrupt))


NO_LOSSES = Losses()


class Lossy(Generic[T]):
    """One direction of a link that drops, repeats, reorders and damages frames, reproducible by its seed."""

    def __init__(self, losses: Losses, seed: str, damage: Callable[[T, random.Random], T | None]) -> None:
        self._losses, self._random, self._damage = losses, random.Random(seed), damage
        self._held: deque[T] = deque()

    def __call__(self, units: Iterable[T]) -> list[T]:
        """The arriving frames; a delayed frame at the end arrives with a later call."""
        if not self._losses:
            return list(units)
        out: list[T] = []
        for unit in units:
            out += self._transmit(unit)
        return out

    def _transmit(self, unit: T) -> Iterable[T]:
        losses, chance = self._losses, self._random.random
        if chance() < losses.drop:
            return
        if chance() < losses.corrupt:
            damaged = self._damage(unit, self._random)
            if damaged is None:
                return
            unit = damaged
        if chance() < losses.reorder:
            self._held.append(unit)
            return
        yield unit
        if chance() < losses.duplicate:
            yield unit
        if self._held and chance() < BOUNDS.release_probability:
            yield self._held.popleft()


class Outbox:
    """Queue of frames to send; telemetry and answers overtake bulk data.

    Parameters
    ----------
    port : Port
    lossy : Lossy
    rate : float, optional
        Bytes per second of the line (bits over 8 on a CAN bus); None: as fast as the port accepts them.
    """

    def __init__(self, port: Port, lossy: Lossy[Unit], rate: float | None) -> None:
        self._port, self._lossy, self._rate = port, lossy, rate
        self._urgent: deque[Frame] = deque()
        self._bulk: deque[Frame] = deque()
        self._coded: deque[Unit] = deque()
        self._credit, self._paid_s, self._taken_s = 0.0, 0.0, 0.0
        self.blocked = False
        """Whether the line or its rate limit refused the last frame."""

    def put(self, frames: Iterable[Frame]) -> None:
        """Queue telemetry and answers."""
        self._urgent.extend(frames)

    def put_bulk(self, frames: Iterable[Frame]) -> None:
        """Queue blocks of a capture with their end; dropped if too many are queued (the host repeats requests)."""
        if len(self._bulk) < BOUNDS.max_waiting_frames:
            self._bulk.extend(frames)

    @property
    def empty(self) -> bool:
        return not (self._urgent or self._bulk or self._coded)

    def clear(self) -> None:
        """Drop all frames, when no host is connected."""
        self._urgent.clear()
        self._bulk.clear()
        self._coded.clear()

    def pump(self, now_s: float) -> None:
        """Send the frames that line and port accept now, without waiting."""
        if self.empty:
            self._taken_s = now_s
        if self._rate is not None:
            earned = (now_s - self._paid_s) * self._rate
            self._credit = min(self._credit + earned, max(self._rate * BOUNDS.max_burst_s, 64.0))
            self._paid_s = now_s
        self.blocked = False
        for _ in range(BOUNDS.max_batch_frames):
            unit = self._first()
            if unit is None:
                return
            self.blocked = self._rate is not None and self._credit <= 0.0
            if self.blocked:
                return
            if not self._port.send(unit):
                self.blocked = True
                break
            self._coded.popleft()
            self._taken_s = now_s
            self._credit -= self._port.cost(unit)
        if now_s - self._taken_s > BOUNDS.max_waiting_s:
            self.clear()

    def _first(self) -> Unit | None:
        while not self._coded and (self._urgent or self._bulk):
            self._coded.extend(self._lossy(map(self._port.coded, self._next())))
        return self._coded[0] if self._coded else None

    def _next(self) -> Iterable[Frame]:
        queue = self._urgent or self._bulk
        for _ in range(min(16, len(queue))):
            yield queue.popleft()

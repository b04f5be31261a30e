"""The emulator's loop over watchdog, link, plant and line, until a signal ends it."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType

from orchestrator.operating_system.signals import handlers
from plugins.commands.emulator._bounds import BOUNDS
from plugins.commands.emulator._device import Device
from plugins.commands.emulator._line import NO_LOSSES, Losses, Lossy, Outbox
from plugins.commands.emulator._log import Log
from plugins.commands.emulator._ports import Port
from plugins.wire import Frame


@dataclass(frozen=True)
class LinkSettings:
    """Rate and losses of the line, and priority of the process."""

    rate: float | None = None
    """Bytes per second; None: as fast as the port accepts them."""
    losses: Losses = NO_LOSSES
    seed: int = 0
    priority: bool = True
    """Whether to request real-time priority."""


class Emulation:
    """A device on a link."""

    def __init__(self, device: Device, port: Port, settings: LinkSettings, log: Log) -> None:
        self._device, self._port, self._log = device, port, log
        self._outbox = Outbox(port, Lossy(settings.losses, f"{settings.seed} out", port.damage), settings.rate)
        self._lossy: Lossy[Frame] = Lossy(settings.losses, f"{settings.seed} in", port.damage_received)
        self._connected: bool | None = None
        self.rests = False
        """Whether each cycle is followed by a pause as long as its computation."""
        self._computed_s = 0.0

    def turn(self) -> None:
        """Run one cycle; waits for the link while nothing else is due."""
        device, power = self._device, self._device.power
        wait_s = device.wait_s()
        if not self._outbox.empty:
            wait_s = min(BOUNDS.backlog_period_s, wait_s) if self._outbox.blocked else 0.0
        if self.rests:
            wait_s = max(wait_s, min(self._computed_s, BOUNDS.max_rest_s))
        power.guard(time.monotonic())
        frames = self._lossy(self._port.receive(wait_s))
        begun_s = time.monotonic()
        self._log_connection()
        power.guard(time.monotonic())
        device.receive(frames)
        device.turn()
        self._outbox.put(device.urgent)
        self._outbox.put_bulk(device.bulk)
        device.urgent.clear()
        device.bulk.clear()
        self._outbox.pump(time.monotonic())
        self._computed_s = time.monotonic() - begun_s

    def _log_connection(self) -> None:
        connected = self._port.connected
        if connected is not None and connected != self._connected:
            if self._connected is not None or connected:
                self._log("link", open=connected)
            self._connected = connected
            if not connected:
                self._outbox.clear()


def run_emulation(device: Device, port: Port, settings: LinkSettings, log: Log) -> None:
    """Run until SIGINT or SIGTERM; then go to the safe state and close the link."""
    emulation = Emulation(device, port, settings, log)
    with _ending_signals() as ending:
        try:
            port.publish()
            # With real-time priority it would take the processors from all others, its host included.
            emulation.rests = settings.priority and _request_priority()
            log("started", pid=os.getpid(), priority=emulation.rests)
            while not ending():
                emulation.turn()
        finally:
            try:
                if device.power.energised:
                    device.power.shut_down()
            finally:
                port.close()
        log("ended")


def _request_priority() -> bool:
    """Request real-time priority, for timing as on a microcontroller; returns whether it was granted."""
    try:
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))
    except (OSError, AttributeError):  # not allowed; not Linux
        return False
    return True


@contextmanager
def _ending_signals() -> Iterator[Callable[[], bool]]:
    caught: list[int] = []

    def record(number: int, frame: FrameType | None) -> None:
        caught.append(number)

    with handlers(dict.fromkeys((signal.SIGINT, signal.SIGTERM), record)):
        yield lambda: bool(caught)

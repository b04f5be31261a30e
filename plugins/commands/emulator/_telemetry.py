"""Periodic telemetry of the device, each message at its own period."""

from __future__ import annotations

import math
from collections.abc import Iterator

from plugins.commands.emulator._bounds import BOUNDS
from plugins.wire import Fault, Measurement, Message, Phase, PowerState, Progress, Status, Tick


class Telemetry:
    """Sequence numbers and due times of the periodic messages."""

    def __init__(self, now_s: float) -> None:
        self._born_s = now_s
        self._status, self._measurement, self._progress = 0, 0, 0
        self._due_s = self._tick_due_s = self._progress_due_s = now_s
        self._last_status: tuple[object, ...] = ()
        self._phase: tuple[Phase, int] = (Phase.IDLE, 0)

    def status(
        self, now_s: float, state: PowerState, cause: Fault, faults: int, beat: int, v_dc: float, temperature_c: int
    ) -> Iterator[Message]:
        """Status, when due or changed."""
        status = (state, cause, faults)
        if status == self._last_status and now_s < self._due_s:
            return
        self._last_status = status
        self._status = (self._status + 1) % 256
        yield Status(state, cause, beat, faults, _volts(v_dc), temperature_c, self._status)

    def periodic(
        self,
        now_s: float,
        period_s: float,
        shown: tuple[float, float, float],
        scale_a: float,
        ticks: int,
        open_interlocks: int,
    ) -> Iterator[Message]:
        """Measurement and clock, when due; to be called after `status`."""
        if now_s >= self._due_s:
            self._due_s = now_s + period_s if now_s - self._due_s > period_s else self._due_s + period_s
            self._measurement = (self._measurement + 1) % 256
            i_d, i_q = (max(-32768, min(32767, round(i / scale_a))) for i in shown[:2])
            yield Measurement(self._measurement, i_d, i_q, _volts(shown[2]), open_interlocks)
        if now_s >= self._tick_due_s:
            self._tick_due_s = now_s + BOUNDS.tick_period_s
            yield self.tick(now_s, ticks)

    def wait_s(self, now_s: float) -> float:
        """Time until a message is due [s]."""
        return max(0.0, min(self._due_s, self._tick_due_s) - now_s)

    def tick(self, now_s: float, ticks: int) -> Tick:
        """The present clock."""
        return Tick(ticks % (1 << 32), int((now_s - self._born_s) * 1e6) % (1 << 32))

    def progress(self, now_s: float, phase: Phase, capture: int, rows: int, running: bool) -> Iterator[Message]:
        """Progress, when the phase changes and periodically while a program runs."""
        changed = (phase, capture) != self._phase
        if not changed and not (running and now_s >= self._progress_due_s):
            return
        self._phase = (phase, capture)
        self._progress_due_s = now_s + BOUNDS.progress_period_s
        self._progress = (self._progress + 1) % 256
        yield Progress(self._progress, phase, capture, rows)


def _volts(v_dc: float) -> float:
    return min(max(v_dc, 0.0), 1310.0) if math.isfinite(v_dc) else 0.0

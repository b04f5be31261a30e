"""Runs a program on the drive: starts it, monitors it to its end and yields its rows."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

from orchestrator.driving import keepalive
from plugins.link._claims import ProgramProgress
from plugins.link._demodulated import RippleRead, ripple_periods
from plugins.link._host import Host
from plugins.link._machine import Machine, Rows, SecondsOfTick
from plugins.link._raw import RawRead
from plugins.link._timeline import Timeline
from plugins.link._timeouts import TIMEOUTS, ProcessClock
from plugins.wire import (
    Capability,
    Channel,
    Op,
    Phase,
    PowerState,
    Progress,
    capture_registers,
    program_registers,
)
from protocols import Capture, DriveFault, DriveRefused, Excitation, FaultCause, Injection

MIN_BLOCK_S = 0.1
"""Shortest block, except the last one."""
MAX_BLOCK_S = 0.25
"""Longest block."""


class Program:
    """A program that the drive runs.

    Parameters
    ----------
    host : Host
    machine : Machine
    excitation : Excitation
    timeline : Timeline
        The drive's clock.
    require_sound : callable
        Raises `DriveFault` for inconsistent telemetry.

    Raises `DriveRefused` where the drive does not start it.
    """

    def __init__(
        self,
        host: Host,
        machine: Machine,
        excitation: Excitation,
        timeline: Timeline,
        check_telemetry: Callable[[], None],
    ) -> None:
        self._host, self._machine, self._excitation = host, machine, excitation
        self._timeline, self._check_telemetry = timeline, check_telemetry
        self._fs = machine.capabilities.sampling_frequency_hz
        self._rows = excitation.rows(self._fs)
        periods = 0
        if machine.demodulated and isinstance(excitation, Injection):
            periods = ripple_periods(excitation, machine.facts)
        channels = Channel(0) if periods else machine.channels
        values = program_registers(excitation, self._fs) | capture_registers(channels, ripple_periods=periods)
        if periods and machine.facts.bits & Capability.RIPPLE_CURVATURE:
            values["ripple_curvature"] = 1.0
        host.write(values)
        self.number = host.do(Op.RUN_PROGRAM).value
        self._source: Rows
        if periods and isinstance(excitation, Injection):
            self._source = RippleRead(host, machine, self.number, excitation, periods)
        else:
            self._source = RawRead(host, machine, self.number, self._rows)
        self._has_run = False
        self._seen = ProgramProgress(self._rows)
        self._clock = ProcessClock()
        self._moved_s = 0.0

    def captures(self, seconds_of_tick: SecondsOfTick) -> Iterator[Capture]:
        """Blocks of its rows, and empty blocks as keepalives.

        Raises `DriveFault` where the drive trips, is lost, or sends inconsistent data.
        """
        yielded, start = 0, None
        yielded_s = time.monotonic()
        finished = False
        while not finished:
            progress = self._watch()
            started = progress is not None and progress.phase in (Phase.CAPTURING, Phase.COMPLETE)
            complete = self._is_complete(progress)
            finished = self._source.poll(progress.rows if progress else 0, complete, TIMEOUTS.receive_s)
            if start is None and (started or complete):
                start = self._timeline.begin_capture(self._start_tick())
            if start is not None and finished:
                self._timeline.end_capture(start, self._rows)
            while start is not None and self._due(yielded, finished):
                stop = min(self._source.ready, yielded + round(MAX_BLOCK_S * self._fs))
                yield self._source.block(yielded, stop, seconds_of_tick(start) + yielded / self._fs)
                yielded, yielded_s = stop, time.monotonic()
            if time.monotonic() - yielded_s > TIMEOUTS.keepalive_period_s:
                tick = self._host.link.news.tick
                yield keepalive(seconds_of_tick(self._timeline.count(tick.tick)) if tick else 0.0, self._fs)
                yielded_s = time.monotonic()

    def _due(self, yielded: int, finished: bool) -> bool:
        ready = self._source.ready - yielded
        return ready > 0 and (finished or ready >= round(MIN_BLOCK_S * self._fs))

    def _start_tick(self) -> int:
        return int(self._host.read("capture_start_low")) + 65536 * int(self._host.read("capture_start_high"))

    # Monitoring

    def _watch(self) -> Progress | None:
        """The program's progress; raises `DriveFault` or `DriveRefused` where it is irregular."""
        self._host.link.check()
        status, progress = self._host.link.news.status, self._host.link.news.progress
        if progress is not None and progress.capture != self.number:
            progress = None
        if status is not None and status.state is PowerState.FAULTED:
            raise self._host.fault()
        if status is not None and status.state is PowerState.DISARMED and self._has_run:
            raise DriveFault(FaultCause.INTERNAL, "the drive disarmed itself during a program")
        if progress is not None and progress.phase is Phase.GIVEN_UP:
            raise DriveRefused("the excitation was aborted")
        self._check_telemetry()
        self._has_run = self._has_run or (status is not None and status.state is PowerState.RUNNING)
        self._require_progress(progress)
        return progress

    def _is_complete(self, progress: Progress | None) -> bool:
        """Whether the program is complete by its progress, or by the next state where that message was lost."""
        if progress is not None and progress.phase is Phase.COMPLETE:
            return True
        status = self._host.link.news.status
        return self._has_run and status is not None and status.state is PowerState.HOLDING

    def _require_progress(self, progress: Progress | None) -> None:
        """Raises `DriveFault` where the program stalls, goes back, or exceeds its time."""
        now_s, excitation = self._clock(), self._excitation
        if (progress is not None and self._seen.update(progress)) or self._is_complete(progress):
            self._moved_s = now_s
        timeout_s = TIMEOUTS.no_progress_s + excitation.settling_s
        if now_s - self._moved_s > timeout_s:
            message = f"{excitation.kind}: no progress for {timeout_s:.3g} s ({self._seen.phase.name.lower()})"
            raise DriveFault(FaultCause.NO_ANSWER, message)
        max_s = TIMEOUTS.no_progress_s + TIMEOUTS.max_duration_ratio * (excitation.settling_s + excitation.captured_s)
        if now_s > max_s and not self._is_complete(progress):
            message = f"{excitation.kind}: not complete after {max_s:.3g} s ({self._seen.phase.name.lower()})"
            raise DriveFault(FaultCause.PROGRAM_TOO_LONG, message)

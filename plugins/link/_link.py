"""The receive loop of a link: one thread that reads and sorts messages and detects a silent drive.

A lost link stays lost.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Sequence

from plugins.link._errors import link_errors
from plugins.link._port import Port
from plugins.link._timeouts import TIMEOUTS, ProcessClock
from plugins.wire import (
    STALE_PERIODS,
    Ack,
    Frame,
    Measurement,
    Message,
    Op,
    ParameterValue,
    Progress,
    Status,
    TelemetryGate,
    Tick,
    decode,
    encode,
    frame_id,
)
from protocols import DriveFault, FaultCause

_FROM_DRIVE = frame_id("Status")
"""Lowest identifier of a drive; lower ones are the host's, which some buses echo."""


PROGRESS_PERIOD_S = 0.1
"""Period of a program's progress messages."""


class LatestMessages:
    """The latest of each unsolicited message of the drive, and their counts."""

    def __init__(self) -> None:
        self.status: Status | None = None
        self.measurement: Measurement | None = None
        self.progress: Progress | None = None
        self.tick: Tick | None = None
        self.faulted: Status | None = None
        """First status with a fault since the faults were cleared; a later one must have it as well."""
        self.statuses = self.measurements = self.ticks = 0


class Link:
    """A link with its receive thread.

    Parameters
    ----------
    port : Port
        Open; the link closes it.
    telemetry_s : float
        Period of the drive's Status; after three of them without one the drive is lost.
    """

    def __init__(self, port: Port, telemetry_s: float) -> None:
        self.port, self.news = port, LatestMessages()
        self._period_s = telemetry_s
        self._status_gate, self._measurement_gate = TelemetryGate(telemetry_s), TelemetryGate(telemetry_s)
        self._progress_gate = TelemetryGate(PROGRESS_PERIOD_S)
        self._replies: deque[Ack | ParameterValue] = deque(maxlen=TIMEOUTS.max_replies)
        self._bulk: deque[Frame] = deque(maxlen=TIMEOUTS.max_bulk_frames)
        self._bulk_ids = {frame_id("Bulk"), frame_id("BulkFD"), frame_id("BulkEnd")}
        self._bulk_end, self._has_ended = frame_id("BulkEnd"), False
        self._changed, self._sending = threading.Condition(), threading.Lock()
        self._lost: DriveFault | None = None
        self._silent_s = 0.0
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._listen, name=f"link {port.where}", daemon=True)
        self._thread.start()

    @property
    def lost(self) -> DriveFault | None:
        """The fault by which the link was lost, or None."""
        return self._lost

    def lose(self, fault: DriveFault) -> DriveFault:
        """Mark the link as lost; returns the first reason."""
        with self._changed:
            self._lost = self._lost or fault
            self._changed.notify_all()
            return self._lost

    def check(self) -> None:
        """Raise the fault by which the link was lost, if any."""
        if self._lost is not None:
            raise DriveFault(self._lost.cause, self._lost.detail)

    def close(self) -> None:
        """End the thread and close the port."""
        self._over.set()
        self._thread.join(timeout=2.0)
        with link_errors(self.port.where):
            self.port.close()

    # Sending

    def send(self, *messages: Message) -> None:
        """Send; raises `DriveFault` (link_lost) where the link is lost or accepts no data."""
        self.check()
        try:
            with link_errors(self.port.where), self._sending:
                accepted = self.port.send([encode(message) for message in messages], TIMEOUTS.send_s)
        except DriveFault as fault:
            raise self.lose(fault) from fault.__cause__
        if not accepted:
            raise self.lose(
                DriveFault(FaultCause.LINK_LOST, f"{self.port.where}: accepts no data for {TIMEOUTS.send_s:g} s")
            )

    def try_to_send(self, *messages: Message) -> None:
        """Send as far as possible without waiting, even if the link is lost; never raises."""
        if not self._sending.acquire(timeout=TIMEOUTS.heartbeat_s):
            return
        try:
            with link_errors(self.port.where):
                self.port.send([encode(message) for message in messages], TIMEOUTS.heartbeat_s)
        except DriveFault as fault:
            self.lose(fault)
        finally:
            self._sending.release()

    # Receiving

    def reply(self, wanted: Callable[[Message], bool], timeout_s: float) -> Ack | ParameterValue | None:
        """The reply that fulfils `wanted`; others are late copies and dropped."""
        matching: list[Ack | ParameterValue] = []

        def find_reply() -> bool:
            while self._replies and not matching:
                reply = self._replies.popleft()
                if wanted(reply):
                    matching.append(reply)
            return bool(matching)

        self.wait(find_reply, timeout_s)
        return matching[0] if matching else None

    def wait(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        """Wait for a condition, checked on each reception; raises `DriveFault` where the link is lost."""
        clock, is_fulfilled = ProcessClock(), False
        with self._changed:
            while not is_fulfilled and (remaining_s := timeout_s - clock()) > 0.0:
                is_fulfilled = self._changed.wait_for(
                    lambda: self._lost is not None or condition(), min(remaining_s, TIMEOUTS.receive_s)
                )
            is_fulfilled = is_fulfilled or condition()
        self.check()
        return is_fulfilled

    def bulk(self, timeout_s: float) -> Sequence[Frame]:
        """Upload frames since the last call, waiting for a batch of blocks or the end of an answer."""
        self.wait(lambda: self._has_ended or len(self._bulk) >= TIMEOUTS.wake_bulk_frames, timeout_s)
        with self._changed:
            frames = list(self._bulk)
            self._bulk.clear()
            self._has_ended = False
        return frames

    # The thread

    def _listen(self) -> None:
        try:
            while not self._over.is_set():
                begun_s = time.monotonic()
                with link_errors(self.port.where):
                    frames = self.port.receive(TIMEOUTS.receive_s)
                self._sort(frames)
                self._count_silence(time.monotonic() - begun_s)
        except DriveFault as fault:
            self.lose(fault)
        except Exception as error:  # any error of the thread has to reach the run
            self.lose(DriveFault(FaultCause.LINK_LOST, f"{self.port.where}: {type(error).__name__}: {error}"))

    def _count_silence(self, listened_s: float) -> None:
        """Add listening time to the drive's silence, without time in which this process was suspended."""
        self._silent_s += min(listened_s, 2.0 * TIMEOUTS.receive_s)
        if self._silent_s > STALE_PERIODS * self._period_s and self.news.statuses and self._lost is None:
            message = f"the drive is silent: no status for {STALE_PERIODS} periods of {self._period_s:g} s"
            self.lose(DriveFault(FaultCause.LINK_LOST, f"{self.port.where}: {message}"))

    def _sort(self, frames: Sequence[Frame]) -> None:
        bulk = [frame for frame in frames if frame.frame_id in self._bulk_ids]
        others = (f for f in frames if f.frame_id >= _FROM_DRIVE and f.frame_id not in self._bulk_ids)
        messages = [(message, frame) for frame in others if (message := decode(*frame)) is not None]
        if not bulk and not messages:
            return
        now_s = time.monotonic()
        with self._changed:
            self._bulk.extend(bulk)
            self._has_ended = self._has_ended or any(frame.frame_id == self._bulk_end for frame in bulk)
            for message, frame in messages:
                self._take(message, frame, now_s)
            self._changed.notify_all()

    def _take(self, message: Message, frame: Frame, now_s: float) -> None:
        news = self.news
        match message:
            case Ack(op=Op.READ_BLOCK):
                self._bulk.append(frame)
                self._has_ended = True
            case Ack() | ParameterValue():
                self._replies.append(message)
            case Status() if self._status_gate.accept(message.seq, now_s):
                news.status, news.statuses, self._silent_s = message, news.statuses + 1, 0.0
                if message.faults and news.faulted is None:
                    news.faulted = message
            case Measurement() if self._measurement_gate.accept(message.seq, now_s):
                news.measurement, news.measurements = message, news.measurements + 1
            case Progress() if self._progress_gate.accept(message.seq, now_s):
                news.progress = message
            case Tick():
                news.tick, news.ticks = message, news.ticks + 1

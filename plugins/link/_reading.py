"""Reads a capture from the drive, also while it grows, with repeated requests for missing blocks."""

from __future__ import annotations

from typing import TYPE_CHECKING

from plugins.link._timeouts import TIMEOUTS, ProcessClock
from plugins.wire import BlockLayout, CaptureAssembly
from protocols import DriveFault, FaultCause

if TYPE_CHECKING:
    from plugins.link._host import Host


class Reader:
    """Reader of one capture.

    Parameters
    ----------
    host : Host
        Keeps the next request tag, so that tags differ from those of the previous capture.
    capture, length : int
        Number and bytes of the complete capture.
    layout : BlockLayout
    """

    def __init__(self, host: Host, capture: int, length: int, layout: BlockLayout) -> None:
        self._host, self._link = host, host.link
        port = host.link.port
        self.assembly = CaptureAssembly(
            capture,
            length,
            layout,
            first_window=host.next_window,
            blocks_each=port.blocks_each,
            requests_each=port.requests_each,
        )
        self._clock = ProcessClock()
        self._requested_s = self._received_s = 0.0
        self._rounds, self._before = 0, -1
        self._timeout_s = TIMEOUTS.upload_s

    def poll(self, available: int, wait_s: float) -> memoryview | None:
        """Process received frames and request missing blocks of the `available` bytes; returns the verified capture.

        Raises `DriveFault`: no_answer without any data, wrong_data where the CRC does not match.
        """
        assembly = self.assembly
        available = max(available, assembly.captured)
        self._send_requests(available)
        expects_data = assembly.waiting or assembly.exhausted
        has_frames = assembly.take(self._link.bulk(wait_s))
        now_s = self._clock()
        if has_frames or not expects_data:
            self._received_s = now_s
        if now_s - self._received_s > TIMEOUTS.upload_lost_s:
            raise DriveFault(
                FaultCause.NO_ANSWER, f"no data of capture {assembly.capture} for {TIMEOUTS.upload_lost_s:g} s"
            )
        if expects_data and not assembly.waiting and not assembly.exhausted:
            self._timeout_s = TIMEOUTS.upload_s
        elif now_s - max(self._received_s, self._requested_s) > self._timeout_s:
            assembly.give_up()
            self._timeout_s = min(2.0 * self._timeout_s, TIMEOUTS.max_upload_s)
        return assembly.result()

    def _send_requests(self, available: int) -> None:
        assembly = self.assembly
        complete = available >= assembly.length
        is_round = not assembly.waiting
        if not complete and self._clock() - self._requested_s < TIMEOUTS.live_read_period_s:
            return
        if not complete and is_round and not assembly.missing(available):
            return
        requests = assembly.requests(None if complete else available)
        if not requests:
            return
        if is_round:
            self._count_round()
        self._host.next_window = assembly.next_window
        self._link.send(*requests)
        self._requested_s = self._clock()

    def _count_round(self) -> None:
        assembly = self.assembly
        self._rounds = 0 if assembly.received != self._before else self._rounds + 1
        self._before = assembly.received
        if self._rounds > TIMEOUTS.max_upload_rounds:
            raise DriveFault(FaultCause.NO_ANSWER, f"capture {assembly.capture} makes no progress")


def read_whole(host: Host, capture: int, length: int, layout: BlockLayout) -> memoryview:
    """Read a capture that is complete on the drive."""
    reader = Reader(host, capture, length, layout)
    while (data := reader.poll(length, TIMEOUTS.receive_s)) is None:
        pass
    return data

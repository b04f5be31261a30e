"""The receive loop: it hears what matters, takes nothing twice, and never dies without a word."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Sequence

import pytest

from plugins.link._link import Link
from plugins.wire import (
    CLASSIC_LAYOUT,
    Ack,
    AckStatus,
    BlockLayout,
    Fault,
    Frame,
    Heartbeat,
    Message,
    Op,
    PowerState,
    Status,
    Tick,
    encode,
)
from protocols import DriveFault, FaultCause


class FakePort:
    """A link whose frames a test puts in, and which may fail on purpose."""

    where = "fake"
    requests_each = blocks_each = 8

    def __init__(self) -> None:
        self.inbox: queue.Queue[list[Frame] | Exception] = queue.Queue()
        self.sent: list[Frame] = []
        self.takes = True
        self.error: Exception | None = None
        self.closed = False

    def layout(self, block_bytes: int) -> BlockLayout:
        return CLASSIC_LAYOUT

    def bulk_rate(self, layout: BlockLayout) -> float | None:
        return None

    def send(self, frames: Sequence[Frame], timeout_s: float) -> bool:
        if self.error is not None:
            raise self.error
        self.sent += frames
        return self.takes

    def receive(self, timeout_s: float) -> list[Frame]:
        try:
            got = self.inbox.get(timeout=timeout_s)
        except queue.Empty:
            return []
        if isinstance(got, Exception):
            raise got
        return got

    def close(self) -> None:
        self.closed = True

    def deliver(self, *messages: Message) -> None:
        self.inbox.put([encode(message) for message in messages])


def status(seq: int, state: PowerState = PowerState.HOLDING) -> Status:
    return Status(state, Fault.NONE, 0, 0, 300.0, 40, seq)


@pytest.fixture
def port() -> FakePort:
    return FakePort()


def lost(link: Link, timeout_s: float = 2.0) -> DriveFault:
    with pytest.raises(DriveFault) as fault:
        link.wait(lambda: False, timeout_s)
    return fault.value


@pytest.mark.parametrize("error", [OSError(5, "Input/output error"), RuntimeError("a defect"), ValueError("torn")])
def test_whatever_the_receive_loop_dies_of_is_received(port: FakePort, error: Exception) -> None:
    link = Link(port, 0.05)
    port.inbox.put(error)
    fault = lost(link)
    assert fault.cause is FaultCause.LINK_LOST
    assert str(error.args[-1]) in fault.detail
    with pytest.raises(DriveFault):
        link.send(Tick(1, 1))
    link.close()
    assert port.closed


def test_errors_of_python_can_and_pyserial_become_a_lost_link(port: FakePort) -> None:
    import can
    import serial

    for error in (can.CanOperationError("bus off"), serial.SerialException("gone"), can.CanTimeoutError("full")):
        link = Link(port, 0.05)
        port.error = error
        with pytest.raises(DriveFault) as fault:
            link.send(Tick(1, 1))
        assert fault.value.cause is FaultCause.LINK_LOST
        assert link.lost is not None
        link.close()


def test_a_link_that_takes_nothing_is_lost(port: FakePort) -> None:
    link = Link(port, 0.05)
    port.takes = False
    with pytest.raises(DriveFault, match="accepts no data"):
        link.send(Tick(1, 1))
    link.close()


def test_a_beat_never_raises_and_does_not_wait_for_a_send_that_hangs(port: FakePort) -> None:
    link = Link(port, 0.05)
    beat = Heartbeat(1, 1, 1)
    with link._sending:
        done = threading.Event()

        def send_beat() -> None:
            link.try_to_send(beat)
            done.set()

        threading.Thread(target=send_beat).start()
        assert done.wait(1.0)
    assert not port.sent
    port.error = OSError("gone")
    link.try_to_send(beat)
    assert lost(link).cause is FaultCause.LINK_LOST
    link.close()


def test_silence_after_a_first_status_is_a_lost_link(port: FakePort) -> None:
    link = Link(port, 0.05)
    port.deliver(status(1))
    begun = time.monotonic()
    assert "silent" in lost(link).detail
    assert 0.12 < time.monotonic() - begun < 1.0
    link.close()


def test_an_old_status_is_no_keepalive(port: FakePort) -> None:
    link = Link(port, 0.1)
    port.deliver(status(100))
    for seq in (99, 98, 100):
        time.sleep(0.05)
        port.deliver(status(seq, PowerState.FAULTED))
    assert link.news.status == status(100)
    assert "silent" in lost(link).detail
    link.close()


def test_time_in_which_this_process_did_not_listen_does_not_count(port: FakePort) -> None:
    class Stopped(FakePort):
        def receive(self, timeout_s: float) -> list[Frame]:
            if self.inbox.empty() and self.sent:
                self.sent.clear()
                time.sleep(0.5)  # as if stopped, and continued
            return super().receive(timeout_s)

    stopped = Stopped()
    link = Link(stopped, 0.05)
    stopped.deliver(status(1))
    assert link.wait(lambda: link.news.statuses == 1, 1.0)
    stopped.sent.append(Frame(0, b""))
    time.sleep(0.45)
    for seq in range(2, 12):
        stopped.deliver(status(seq))
        time.sleep(0.02)
    assert link.lost is None
    link.close()


def test_its_own_frames_and_strangers_are_passed_over(port: FakePort) -> None:
    link = Link(port, 1.0)
    own = encode(Heartbeat(1, 1, 1))
    port.inbox.put([own, Frame(0x7FF, b"stranger"), Frame(0x90, b"short")])
    port.deliver(Ack(7, 9, Op.ARM, AckStatus.OK, PowerState.HOLDING, 3))
    reply = link.reply(lambda message: True, 1.0)
    assert isinstance(reply, Ack)
    assert reply.value == 3
    link.close()


def test_a_late_reply_is_dropped(port: FakePort) -> None:
    link = Link(port, 1.0)
    port.deliver(*(Ack(7, seq, Op.ARM, AckStatus.OK, PowerState.HOLDING, seq) for seq in (1, 2, 3)))
    reply = link.reply(lambda message: isinstance(message, Ack) and message.seq == 2, 1.0)
    assert isinstance(reply, Ack)
    assert reply.seq == 2
    link.close()

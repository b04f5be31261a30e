"""What ripple rows take of a classic bus while they are made, counted bit by bit by somebody who listens on it."""

from __future__ import annotations

import threading
import time

import can
import pytest

from plugins.wire import TELEMETRY_PERIOD_S, frame_id
from protocols import Injection, Limits
from tests.plugins.commands.emulator.buses import connected, emulated
from tests.plugins.link.bench import beating

BIT_RATE = 1e6
INJECTION = Injection(
    target_d_a=0.5,
    target_q_a=1.0,
    settle_s=0.2,
    duration_s=3.0,
    amplitude_v=20.0,
    frequency_hz=500.0,
    rotation_hz=4.0,
)


def bits_on_the_bus(identifier: int, payload: bytes) -> int:
    """Bits of a classic frame, stuff bits and interframe space included (ISO 11898-1)."""
    head = f"0{identifier:011b}000{len(payload):04b}" + "".join(f"{byte:08b}" for byte in payload)
    register = 0
    for bit in head:
        feedback = register >> 14 ^ int(bit)
        register = (register << 1 & 0x7FFF) ^ (0x4599 if feedback else 0)
    stuffed, run, before, total = f"{head}{register:015b}", 0, "", 0
    for bit in stuffed:
        run = run + 1 if bit == before else 1
        before, total = bit, total + 1
        if run == 5:
            before, run, total = "10"[int(bit)], 1, total + 1
    return total + 13


def test_bits_are_counted_with_those_that_are_stuffed() -> None:
    assert bits_on_the_bus(0, b"") == 47 + 6  # 34 zeros, their CRC among them: one more bit after every five
    for payload in (bytes(8), bytes(range(8)), b"\xff" * 8):
        assert 47 + 64 <= bits_on_the_bus(0x0C0, payload) <= 47 + 64 + 24


@pytest.mark.slow
def test_rows_read_while_they_are_made_take_less_than_a_fifth_of_a_classic_bus_at_1_mbit_s() -> None:
    frames: list[tuple[float, int, int]] = []
    over = threading.Event()
    with can.Bus(channel="load", interface="virtual", ignore_config=True) as bus, emulated("load", fd=False):

        def listen() -> None:
            while not over.is_set():
                message = bus.recv(0.05)
                if message is not None:
                    bits = bits_on_the_bus(message.arbitration_id, bytes(message.data))
                    frames.append((time.monotonic(), message.arbitration_id, bits))

        listener = threading.Thread(target=listen, daemon=True)
        listener.start()
        try:
            live = capture_live()
        finally:
            over.set()
            listener.join()
    # The description was read before: a second or more without a block lies between.
    blocks = [at for at, identifier, _ in frames if identifier == frame_id("Bulk")]
    begun = max((k for k in range(1, len(blocks)) if blocks[k] - blocks[k - 1] > 0.2), default=0)
    blocks = blocks[begun:]
    first, last = blocks[0], blocks[-1]
    load = sum(bits for at, _, bits in frames if first <= at <= last) / (last - first) / BIT_RATE
    rows_hz = (len(blocks) - 1) / (last - first) * 6 / 16
    print(f"{rows_hz:.0f} ripple rows a second with all else take {100 * load:.1f} % of a classic bus")
    assert live > 0
    assert rows_hz == pytest.approx(500.0, rel=0.05)
    assert load < 0.2


def capture_live() -> int:
    """Run the injection; rows that came before its end."""
    with connected("load", fd=False, capture="demodulated") as drive, beating(drive):
        assert drive._host is not None
        drive._host.write({"telemetry_period_s": TELEMETRY_PERIOD_S}, anew=True)  # as often as on a bench
        drive.arm(Limits(current_a=4.0, voltage_v=150.0))
        sizes = [len(block) for block in drive.execute(INJECTION)]
        drive.disarm()
    assert sum(sizes) == 30_000
    return sum(sizes[:-2])

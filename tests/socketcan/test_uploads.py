"""Uploads over the kernel's own buses: the capture arrives byte-exact, or is refused; it is never wrong."""

from __future__ import annotations

import itertools
import threading

import can
import numpy as np
import pytest

from plugins.link import Host, Link
from plugins.link._reading import read_whole
from protocols import DriveFault, FaultCause
from tests.socketcan.buses import BUS_OFF, BUSES, ERRORS, FD_BUS, is_fd, report_error
from tests.socketcan.ends import NUMBER, HostPort, Mix, handing_out, peer

ROWS = np.random.default_rng(7).bytes(100_000 * 4 * 2)
"""100,000 rows of four int16 channels."""
MIXES = list(itertools.product((0.0, 0.05), repeat=4))
"""Drops, duplicates, reordering, damage."""


def read(port: HostPort, length: int) -> bytes:
    """The capture, as the host reads it."""
    link = Link(port, 1.0)
    try:
        return bytes(read_whole(Host(link, 1.0), NUMBER, length, link.port.layout(0)))
    finally:
        link.close()


@pytest.mark.timeout(900)
def test_hundred_thousand_rows_arrive_exactly() -> None:
    with peer(handing_out(ROWS, Mix(0.05, 0.05, 0.05, 0.05)), FD_BUS):
        assert read(HostPort(FD_BUS), len(ROWS)) == ROWS


@pytest.mark.parametrize("rates", MIXES, ids=str)
@pytest.mark.parametrize("bus", BUSES)
def test_rows_arrive_exactly_in_every_mix(bus: str, rates: tuple[float, float, float, float]) -> None:
    data = ROWS[: 24_000 if is_fd(bus) else 4_800]
    with peer(handing_out(data, Mix(*rates)), bus):
        assert read(HostPort(bus), len(data)) == data


@pytest.mark.parametrize("unseen", [0.0005, 0.05])
@pytest.mark.parametrize("bus", BUSES)
def test_damage_that_no_controller_sees_is_never_taken_for_data(bus: str, unseen: float) -> None:
    data, refused = ROWS[: 12_000 if is_fd(bus) else 2_400], 0
    for k in range(2):
        with peer(handing_out(data, Mix(0.01, 0.01 * k, 0.01, unseen=unseen)), bus):
            try:
                got = read(HostPort(bus), len(data))
            except DriveFault as fault:
                refused += fault.cause is FaultCause.WRONG_DATA
            else:
                assert got == data
    assert refused or unseen < 0.05, "so much damage cannot have been passed over"


@pytest.mark.parametrize("bus", BUSES)
def test_what_a_host_that_slept_has_lost_is_requested_again(bus: str) -> None:
    data = ROWS[: 60_000 if is_fd(bus) else 12_000]
    port = HostPort(bus, sleep_s=0.3, every=4, buffer_bytes=16_384)
    with peer(handing_out(data, Mix()), bus):
        assert read(port, len(data)) == data
    assert port.overflowed > 0, "the receive buffer held everything: nothing was tested"


@pytest.mark.parametrize("bus", BUSES)
def test_error_frames_are_passed_over(bus: str) -> None:
    data = ROWS[: 60_000 if is_fd(bus) else 12_000]
    over = threading.Event()

    def trouble() -> None:
        for kind in itertools.cycle(ERRORS):
            if over.wait(0.005):
                return
            report_error(bus, kind)

    thread = threading.Thread(target=trouble)
    with peer(handing_out(data, Mix()), bus):
        thread.start()
        try:
            assert read(HostPort(bus), len(data)) == data
        finally:
            over.set()
            thread.join()


@pytest.mark.parametrize("bus", BUSES)
def test_error_frames_reach_those_who_listen(bus: str) -> None:
    with can.Bus(interface="socketcan", channel=bus, fd=is_fd(bus), ignore_config=True) as listener:
        report_error(bus, BUS_OFF)
        received = listener.recv(5.0)
    assert received is not None
    assert received.is_error_frame
    assert received.arbitration_id == BUS_OFF

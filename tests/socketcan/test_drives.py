"""The drive `can` on the kernel's own buses: it measures what is there, and a bus that goes is a lost link."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from plugins.drives.can import CanDrive, CanOptions
from protocols import DriveFault, DriveSetup, FaultCause, Hold, Motor
from tests.plugins.link.bench import LIMITS, beating, taken
from tests.plugins.link.device import waveforms
from tests.socketcan.buses import BUS_OFF, BUSES, ERRORS, down, is_fd, report_error
from tests.socketcan.ends import WATCHDOG_S, peer, running_programs
from tests.support.tiny import MOTOR

HOLD = Hold(current_d_a=1.0, current_q_a=-0.5, rotor_angle_rad=0.3, settle_s=0.5, duration_s=0.5)
LONG = Hold(current_d_a=1.0, current_q_a=-0.5, settle_s=0.5, duration_s=60.0)
COUNT_A = 12.0 / 32767.0
TELEMETRY_S = 1.0
"""Twenty times as long as drives have it: both ends run in a machine that is ten times slower."""
LOST_WITHIN_S = 3.0 * TELEMETRY_S + 1.0


@contextmanager
def drive_on(bus: str) -> Iterator[CanDrive]:
    """Connected, armed and beating."""
    options = CanOptions(
        interface="socketcan", channel=bus, fd=is_fd(bus), telemetry_period_s=TELEMETRY_S, answer_timeout_s=5.0
    )
    drive = CanDrive(DriveSetup(motor=Motor(**MOTOR), options=options, seed=1))
    try:
        drive.connect()
        with beating(drive):
            drive.arm(LIMITS)
            yield drive
    finally:
        drive.close()


def require_the_hold(drive: CanDrive) -> None:
    """What is captured is what the drive did, in the stator frame."""
    i_dq = waveforms(HOLD, 1)[0][0]
    expected = (i_dq[0] + 1j * i_dq[1]) * np.exp(1j * HOLD.rotor_angle_rad)
    capture = taken(drive, HOLD)
    assert len(capture) == round(HOLD.duration_s * capture.sampling_frequency_hz)
    np.testing.assert_allclose(capture.i_ab, [[expected.real, expected.imag]] * len(capture), atol=COUNT_A)


@pytest.mark.parametrize("bus", BUSES)
def test_what_is_captured_is_what_the_drive_did(bus: str) -> None:
    with peer(running_programs, bus) as other, drive_on(bus) as drive:
        require_the_hold(drive)
        drive.ramp_down()
        drive.disarm()
    assert (other.reported.arms, other.reported.cause, other.reported.energised) == (1, "none", False)


@pytest.mark.parametrize("bus", BUSES)
def test_reports_of_errors_alone_stop_nothing(bus: str) -> None:
    over = threading.Event()

    def trouble() -> None:
        while not over.wait(0.01):
            for kind in ERRORS:
                report_error(bus, kind)

    with peer(running_programs, bus) as other, drive_on(bus) as drive:
        thread = threading.Thread(target=trouble)
        thread.start()
        try:
            require_the_hold(drive)
        finally:
            over.set()
            thread.join()
        drive.disarm()
    assert other.reported.cause == "none"


@pytest.mark.parametrize("bus", BUSES)
def test_after_bus_off_the_link_is_lost_and_nothing_is_armed_again(bus: str) -> None:
    with peer(running_programs, bus) as other, drive_on(bus) as drive:
        blocks = drive.execute(LONG)
        while not len(next(blocks)):
            pass
        report_error(bus, BUS_OFF)
        with down(bus):
            off_s = time.monotonic()
            with pytest.raises(DriveFault) as lost:
                list(blocks)
            took_s = time.monotonic() - off_s
            assert lost.value.cause is FaultCause.LINK_LOST
            assert took_s < LOST_WITHIN_S
            time.sleep(WATCHDOG_S)
        for again in (lambda: drive.arm(LIMITS), lambda: drive.execute(LONG), drive.ramp_down):
            with pytest.raises(DriveFault):
                again()
        time.sleep(1.0)
    assert (other.reported.arms, other.reported.cause, other.reported.energised) == (1, "watchdog", False)

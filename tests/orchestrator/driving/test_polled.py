"""Drives that poll their board: check of the link, a held vector, keepalives while waiting, the experiment's clock."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import ClassVar

import numpy as np
import pytest

from orchestrator.driving.polled import PolledDrive
from protocols import (
    Capabilities,
    Capture,
    DriveFault,
    DriveRefused,
    DriveSetup,
    Excitation,
    FaultCause,
    Hold,
    Limits,
    Motor,
    NoOptions,
    ResumableDrive,
    Telemetry,
)

HOLD = Hold(current_d_a=3.0, current_q_a=4.0, settle_s=0.05, duration_s=0.5, rotor_angle_rad=np.pi / 2)
TRIPPED = DriveFault(FaultCause.OVERCURRENT, "5 A")


class Bench:
    """A board without a link."""

    def check(self) -> None:
        return None

    def close(self) -> None:
        return None


class Polled(PolledDrive[Bench]):
    """Holds what it is given, in rows of 100 Hz."""

    name: ClassVar[str] = "polled"
    keepalive_period_s: ClassVar[float] = 0.02

    def __init__(self) -> None:
        motor = Motor(name="none", pole_pairs=1, stator_resistance_ohm=1.0)
        super().__init__(DriveSetup(motor=motor, options=NoOptions(), seed=1))
        self.fault: DriveFault | None = None

    def open(self) -> Capabilities:
        self.board, self.origin_s = Bench(), time.monotonic()
        return Capabilities(
            name="polled",
            sampling_frequency_hz=100.0,
            pwm_frequency_hz=8e3,
            pwm_frequencies_hz=(8e3,),
            dc_bus_voltage_v=50.0,
            max_current_a=10.0,
            max_voltage_v=20.0,
            excitations=frozenset({"hold"}),
            watchdog_s=None,
        )

    def board_fault(self) -> DriveFault | None:
        return self.fault

    def start(self, excitation: Excitation) -> Iterator[Capture]:
        return self.tripping(self._rows(excitation))

    def _rows(self, excitation: Excitation) -> Iterator[Capture]:
        self.aim(excitation)
        yield from self.waiting(excitation.settling_s)
        self.require_sound(self.board_fault())
        i = np.full(excitation.rows(100.0), self.target_a, np.complex128)
        yield from self.blocks(i, i + i, self.now_s(), 50.0)

    def ramp(self) -> None:
        self.target_a = 0j

    def telemetry(self) -> Telemetry:
        return self.reading(1.0 - 2.0j, 50.0)


@pytest.fixture
def drive() -> Polled:
    drive = Polled()
    drive.connect()
    drive.arm(Limits(current_a=6.0, voltage_v=10.0))
    return drive


def test_a_hold_is_waited_for_with_keepalives_and_captured_in_the_stator_s_frame(drive: Polled) -> None:
    blocks = list(drive.execute(HOLD))
    assert len(blocks[0]) == 0
    assert [len(block) for block in blocks if len(block)] == [25, 25]
    np.testing.assert_allclose(blocks[-1].i_ab, np.tile([-4.0, 3.0], (25, 1)), atol=1e-6)
    np.testing.assert_allclose(blocks[-1].v_ab, 2.0 * blocks[-1].i_ab)
    assert blocks[-1].start_s == pytest.approx(blocks[-2].start_s + 0.25)


def test_a_board_s_fault_trips_the_drive_and_stands_in_its_telemetry_with_its_detail(drive: Polled) -> None:
    drive.fault = TRIPPED
    with pytest.raises(DriveFault, match="5 A"):
        drive.execute(HOLD)
    assert drive.target_a == 0j
    assert drive.telemetry().faults == ("overcurrent: 5 A",)


def test_a_board_that_trips_while_a_hold_settles_ends_it(drive: Polled) -> None:
    blocks = drive.execute(HOLD)
    next(blocks)
    drive.fault = TRIPPED
    with pytest.raises(DriveFault, match="5 A"):
        list(blocks)
    assert drive.limits is None


def test_a_board_s_fault_is_ignored_before_arming() -> None:
    drive = Polled()
    drive.connect()
    drive.fault = TRIPPED
    drive.check_link()


def test_the_clock_goes_on_where_a_run_was_resumed(drive: Polled) -> None:
    assert isinstance(drive, ResumableDrive)
    drive.restore("hold-001", 40.0)
    assert 40.0 <= drive.telemetry().time_s < 41.0


def test_a_drive_that_is_not_connected_refuses_and_one_that_is_closed_has_no_board(drive: Polled) -> None:
    drive.close()
    assert drive.board is None
    with pytest.raises(DriveRefused, match="not connected"):
        drive.connected()


def test_a_current_that_does_not_fall_to_zero_is_a_fault(drive: Polled) -> None:
    left = iter([True, True, False])
    drive.await_zero_current(lambda: next(left), 1.0)
    with pytest.raises(DriveFault, match=r"after 0.01 s of ramping down"):
        drive.await_zero_current(lambda: True, 0.01)

"""The firmware's line for classic CAN: on the host, frames written out as a serial CAN adapter does (`slcan`)."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from orchestrator.testing._drive_bench import Heart, measure
from plugins.drives.can import CanDrive, CanOptions
from protocols import DriveSetup, DriveState, Hold, Injection, Limits, Motor
from tests.plugins.wire.firmware.built import build, host_board
from tests.support.tiny import MOTOR

ON_CAN = "-DFB_WATCHDOG_S=5.0f -DFB_LINK_CAN=1"
RESISTANCE_OHM = 4.4
"""Of boards/motor/motor.h."""


@contextmanager
def armed(folder: Path) -> Iterator[CanDrive]:
    with host_board(build(folder / "firmware", "host", ON_CAN), folder) as board:
        bus = {"interface": "slcan", "channel": board.port, "settings": {"sleep_after_open": 0.0}}
        # python-can reads such an adapter letter by letter: what is said of the state may come late behind a capture.
        options = CanOptions.model_validate({**bus, "capture": "demodulated", "telemetry_period_s": 1.0})
        drive = CanDrive(DriveSetup(motor=Motor(**MOTOR), options=options, seed=1))
        drive.connect()
        try:
            with Heart(drive, 0.2):
                drive.arm(Limits(current_a=4.0, voltage_v=150.0))
                yield drive
                drive.ramp_down()
                drive.disarm()
                assert drive.telemetry().state is DriveState.DISARMED
                assert board.lamp is not None
                assert board.lamp.read_text() == "0"
        finally:
            drive.close()


@pytest.mark.slow
def test_rows_and_ripple_rows_come_over_classic_can(tmp_path: Path) -> None:
    with armed(tmp_path) as drive:
        held = measure(drive, Hold(current_d_a=1.0, current_q_a=0.5, settle_s=0.2, duration_s=0.05))
        np.testing.assert_allclose(held.i_ab.mean(axis=0), (1.0, 0.5), atol=0.01)
        np.testing.assert_allclose(held.v_ab.mean(axis=0), RESISTANCE_OHM * np.array((1.0, 0.5)), atol=0.2)
        injection = Injection(
            target_d_a=1.0,
            target_q_a=0.5,
            settle_s=0.2,
            duration_s=0.2,
            amplitude_v=40.0,
            frequency_hz=500.0,
            rotation_hz=5.0,
        )
        rippled = measure(drive, injection)
        assert len(rippled.i_ab) == 2000
        np.testing.assert_allclose(rippled.i_ab.mean(axis=0), (1.0, 0.5), atol=0.05)
        assert np.hypot(*(rippled.v_ab - rippled.v_ab.mean(axis=0)).T).max() == pytest.approx(40.0, rel=0.05)

"""What the drive `xcp` does where the ECU, its XCP or the network is not as it should be."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("pyxcp", reason="the XCP master is an optional extra")

from plugins.drives.xcp import XcpDrive
from plugins.drives.xcp._ecu import Layout, Stream
from plugins.drives.xcp._link import Link
from protocols import DriveFault, DriveRefused, DriveSetup, DriveState, FaultCause, Hold, InputError, Limits, Motor
from tests.plugins.drives.xcp.built import Ecu, Program, build, running
from tests.support.tiny import MOTOR

LIMITS = Limits(current_a=4.0, voltage_v=150.0)
HOLD = Hold(current_d_a=1.0, current_q_a=0.5, settle_s=0.1, duration_s=0.3)
PATIENT = 1_000_000_000
"""Ticks of a dead man that nobody here feeds."""


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Program:
    return build(tmp_path_factory.mktemp("built"), PATIENT)


@pytest.fixture
def ecu(program: Program, tmp_path: Path) -> Iterator[Ecu]:
    with running(program, tmp_path) as ecu:
        yield ecu


def drive_for(ecu: Ecu, motor: dict[str, Any] = MOTOR, **options: Any) -> XcpDrive:
    chosen = ecu.options.model_copy(update=options)
    return XcpDrive(DriveSetup(motor=Motor(**motor), options=chosen, seed=1))


@contextmanager
def armed(ecu: Ecu, **options: Any) -> Iterator[XcpDrive]:
    drive = drive_for(ecu, **options)
    drive.connect()
    try:
        drive.arm(LIMITS)
        yield drive
    finally:
        drive.close()


def test_a_row_that_is_lost_is_a_fault_and_the_gates_go_off(ecu: Ecu) -> None:
    with armed(ecu) as drive:
        under_way = drive.execute(HOLD.model_copy(update={"duration_s": 5.0}))
        while len(next(under_way)) == 0:
            pass
        ecu.lose_a_row()
        with pytest.raises(DriveFault, match="rows are missing between the ticks") as fault:
            list(under_way)
        assert fault.value.cause is FaultCause.WRONG_DATA
        assert not ecu.gates_are_on


def test_an_answer_that_is_lost_is_requested_once_more(ecu: Ecu) -> None:
    with armed(ecu, timeout_s=2.0) as drive:
        ecu.process.send_signal(signal.SIGUSR2)
        measured = np.concatenate([block.i_ab for block in drive.execute(HOLD)])
        np.testing.assert_allclose(measured.mean(axis=0), (1.0, 0.5), atol=0.01)


def test_an_ecu_that_is_gone_is_a_lost_link(ecu: Ecu) -> None:
    with armed(ecu, timeout_s=1.0) as drive:
        under_way = drive.execute(HOLD.model_copy(update={"duration_s": 5.0}))
        while len(next(under_way)) == 0:
            pass
        ecu.process.send_signal(signal.SIGSTOP)
        with pytest.raises(DriveFault) as fault:
            list(under_way)
        assert fault.value.cause is FaultCause.LINK_LOST
        with pytest.raises(DriveFault):
            drive.ramp_down()
        drive.heartbeat()


def test_an_ecu_that_is_driven_already_is_refused(ecu: Ecu) -> None:
    with armed(ecu), pytest.raises(DriveRefused, match="another host controls it"):
        drive_for(ecu).connect()


def test_what_does_not_stand_in_the_ecu_after_writing_is_a_fault(ecu: Ecu, monkeypatch: pytest.MonkeyPatch) -> None:
    write = Link.write

    def spoilt(self: Link, offset: int, data: bytes) -> None:
        changed = np.frombuffer(data, self.layout.program).copy() if offset == self.layout.program_at else None
        if changed is not None:
            changed["limit_current_a"] += 1.0
        write(self, offset, data if changed is None else changed.tobytes())

    monkeypatch.setattr(Link, "write", spoilt)
    drive = drive_for(ecu)
    drive.connect()
    with pytest.raises(DriveFault, match=r"limit_current_a is 5\.0 in the ECU after 4\.0 was written"):
        drive.arm(LIMITS)
    assert not ecu.gates_are_on
    drive.close()


def test_the_routine_itself_refuses_what_is_past_the_limits(ecu: Ecu, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("orchestrator.driving.refuse_excitation", lambda *arguments: None)
    with armed(ecu) as drive:
        with pytest.raises(DriveRefused, match="routine refuses to run"):
            drive.execute(HOLD.model_copy(update={"current_d_a": 4.1}))
        assert drive.telemetry().state is DriveState.ARMED


def test_an_address_at_which_something_else_stands_is_reported(ecu: Ecu) -> None:
    drive = drive_for(ecu, address=ecu.options.address + 4)
    with pytest.raises(DriveFault, match="fluxbench"):
        drive.connect()


@pytest.mark.parametrize("protocol", ["udp", "tcp"])
def test_nobody_there_is_a_lost_link_in_one_line(ecu: Ecu, protocol: str, capfd: pytest.CaptureFixture[str]) -> None:
    drive = drive_for(ecu, port=1, protocol=protocol, timeout_s=0.1)
    with pytest.raises(DriveFault) as fault:
        drive.connect()
    drive.close()
    assert fault.value.cause is FaultCause.LINK_LOST
    assert capfd.readouterr().err == ""


def test_a_nameplate_without_inductances_cannot_be_tuned_for(ecu: Ecu) -> None:
    drive = drive_for(ecu, {name: value for name, value in MOTOR.items() if name != "q_inductance_h"})
    with pytest.raises(InputError, match="q_inductance_h"):
        drive.connect()
    drive.close()


def test_a_routine_without_a_dead_man_claims_none(tmp_path: Path) -> None:
    with running(build(tmp_path / "built", 0), tmp_path) as ecu:
        drive = drive_for(ecu)
        says = drive.connect()
        assert (says.watchdog_s, says.watchdog_covers) == (None, frozenset())
        drive.close()


@pytest.mark.parametrize("order", ["<", ">"])
def test_ticks_begin_anew_and_either_byte_order_is_read(order: str) -> None:
    rows = np.zeros(5, Layout(order).row)
    rows["tick"] = np.array([2**32 - 2, 2**32 - 1, 0, 1, 2], np.uint64).astype(np.uint32)
    rows["status"] = [1 | 7 << 16, *[1 | 1 << 2 | 7 << 16] * 3, 1 | 2 << 2 | 7 << 16]
    stream = Stream(7)
    assert [len(stream.captured(part)) for part in (rows[:2], rows[2:2], rows[2:])] == [1, 0, 2]
    with pytest.raises(DriveFault, match="between the ticks 2 and 4"):
        stream.captured(np.array([(4, *rows[-1].tolist()[1:])], rows.dtype))

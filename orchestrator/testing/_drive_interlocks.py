"""Drive checks: interlock inputs that are open forbid power, and are named."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import pytest

from orchestrator.testing._drive_bench import DriveBench, Session
from protocols import Drive, DriveFault, DriveRefused, DriveState

MAX_REPORT_DELAY_S = 2.0
"""Time within which a changed input appears in telemetry."""


class DriveInterlockChecks(DriveBench):
    """For drives that claim interlock inputs, on benches that can open them."""

    def open_interlocks(self, drive: Drive, names: tuple[str, ...]) -> bool:
        """Open these inputs and close all others; False, the default, where nothing on the bench can."""
        return False

    def test_an_open_interlock_forbids_arming(self, tmp_path: Path) -> None:
        with self.connected(tmp_path) as session:
            name = self._last_input(session)
            self._open(session, name)
            try:
                with pytest.raises(DriveRefused) as refused:
                    session.drive.arm(session.sizes.limits)
                assert name in str(refused.value), f"refused to arm, and did not name {name!r}: {refused.value}"
                assert session.drive.telemetry().state is DriveState.DISARMED, "armed in spite of its refusal"
                assert not self.bridge_is_on(session.drive), "an instrument says that the bridge is on"
            finally:
                self._close(session)
            with self.beating(session):
                assert session.drive.telemetry().state is DriveState.ARMED, "does not arm with all interlocks closed"

    def test_an_interlock_that_opens_while_armed_disarms_and_is_named(self, tmp_path: Path) -> None:
        with self.connected(tmp_path) as session:
            name = self._last_input(session)
            session.requires("hold")
            try:
                with self.beating(session), pytest.raises(DriveFault) as fault:
                    self._hold_while_it_opens(session, name)
                assert name in str(fault.value), f"tripped, and did not name {name!r}: {fault.value}"
                self._require_off(session)
            finally:
                self._close(session)
            self._require_off(session)
            session.drive.clear_fault()
            assert session.drive.telemetry().state is DriveState.DISARMED, "not disarmed after clear_fault"
            with self.beating(session):
                assert session.drive.telemetry().state is DriveState.ARMED, "does not arm after clear_fault"

    def _last_input(self, session: Session) -> str:
        """Its name. Skips where there is none, or nothing that opens it."""
        if not session.capabilities.interlocks:
            pytest.skip("this drive claims no interlock inputs")
        if not self.open_interlocks(session.drive, ()):
            pytest.skip("nothing on this bench opens its interlocks (open_interlocks)")
        return session.capabilities.interlocks[-1]

    def _open(self, session: Session, name: str) -> None:
        self.open_interlocks(session.drive, (name,))
        _require(lambda: session.drive.telemetry().open_interlocks == (name,), f"telemetry does not say {name!r} alone")

    def _hold_while_it_opens(self, session: Session, name: str) -> None:
        """The drive trips in this hold or, where that was captured already, at the next one."""
        under_way = iter(session.drive.execute(session.sizes.hold()))
        next(under_way)
        self._open(session, name)
        for _ in under_way:
            pass
        session.measure(session.sizes.hold())

    def _close(self, session: Session) -> None:
        self.open_interlocks(session.drive, ())
        _require(lambda: not session.drive.telemetry().open_interlocks, "telemetry says open what was closed")

    def _require_off(self, session: Session) -> None:
        telemetry = session.drive.telemetry()
        assert telemetry.state is DriveState.FAULTED, f"{telemetry.state.value} after an interlock has opened"
        assert abs(session.current_now()) <= self.tolerance_a(session), "a current flows beside an open interlock"
        assert not self.bridge_is_on(session.drive), "an instrument says that the bridge is on"


def _require(holds: Callable[[], bool], message: str) -> None:
    until_s = time.monotonic() + MAX_REPORT_DELAY_S
    while not holds():
        assert time.monotonic() < until_s, message

"""Drive checks: limits, ways out, the dead man, and taking a run up again."""

from __future__ import annotations

import math
import time
from pathlib import Path

import numpy as np
import pytest

from orchestrator.testing._drive_bench import DriveBench, Measured, Session
from protocols import (
    DriveError,
    DriveFault,
    DriveRefused,
    DriveState,
    Excitation,
    FaultCause,
    GatesOff,
    Hold,
    ResumableDrive,
)

KINDS = ("gates_off", "hold", "trapezoid", "injection", "steps")


class DriveSafetyChecks(DriveBench):
    """Checks that protect motor, drive and people."""

    def test_targets_past_the_limits_are_refused_before_moving(self, tmp_path: Path) -> None:
        with self.armed(tmp_path) as session:
            for what, excitation in _past_the_limits(session):
                try:
                    session.measure(excitation)
                except DriveRefused:
                    pass
                else:
                    pytest.fail(f"executed {what}")
                assert abs(session.current_now()) <= self.tolerance_a(session), f"refused {what}, but moved"

    def test_a_target_that_is_no_number_is_refused(self, tmp_path: Path) -> None:
        with self.armed(tmp_path) as session:
            session.requires("hold")
            unchecked = session.sizes.hold().model_copy(update={"current_d_a": math.nan})
            with pytest.raises(DriveRefused):
                session.measure(unchecked)

    def test_drive_goes_on_holding_until_it_is_ramped_down(self, tmp_path: Path) -> None:
        with self.armed(tmp_path) as session:
            session.requires("hold")
            session.measure(session.sizes.hold(1.0, 0.0))
            assert session.drive.telemetry().state is DriveState.ARMED
            off = abs(session.current_now() - session.sizes.current_a)
            assert off <= 2.0 * self.tolerance_a(session), "the operating point is not held after the excitation"
            session.drive.ramp_down()
            assert abs(session.current_now()) <= self.tolerance_a(session), "a current flows after ramp_down"
            assert session.drive.telemetry().state is DriveState.ARMED, "ramp_down is not meant to disarm"

    def test_ramp_down_and_disarm_may_be_repeated(self, tmp_path: Path) -> None:
        with self.armed(tmp_path) as session:
            for _ in range(2):
                session.drive.ramp_down()
            for _ in range(2):
                session.drive.disarm()
            session.drive.ramp_down()
            assert session.drive.telemetry().state is DriveState.DISARMED
            assert abs(session.current_now()) <= self.tolerance_a(session), "a current flows after disarm"

    def test_disarming_under_current_leaves_none(self, tmp_path: Path) -> None:
        with self.armed(tmp_path) as session:
            session.requires("hold")
            session.measure(session.sizes.hold())
            session.drive.disarm()
            assert session.drive.telemetry().state is DriveState.DISARMED
            assert abs(session.current_now()) <= self.tolerance_a(session), "a current flows after disarm"
            with pytest.raises(DriveRefused):
                session.measure(session.sizes.hold())

    def test_an_excitation_can_be_left_early(self, tmp_path: Path) -> None:
        with self.armed(tmp_path) as session:
            session.requires("hold")
            under_way = iter(session.drive.execute(session.sizes.hold()))
            while len(next(under_way)) == 0:
                pass
            if hasattr(under_way, "close"):
                under_way.close()
            session.drive.ramp_down()
            assert abs(session.current_now()) <= self.tolerance_a(session), "left early, and ramp_down did not help"
            measured = session.measure(session.sizes.hold())
            off = abs(complex(*measured.i_ab.mean(axis=0)) - complex(1.0, 0.5) * session.sizes.current_a)
            assert off <= self.tolerance_a(session), "the excitation after one that was left early misses its target"

    def test_a_beating_heart_keeps_the_drive_armed(self, tmp_path: Path) -> None:
        with self.armed(tmp_path) as session:
            time.sleep(2.0 * _watchdog_s(session))
            if "hold" in session.capabilities.excitations:
                session.measure(session.sizes.hold())
            assert session.drive.telemetry().state is DriveState.ARMED, "tripped although the heart was beating"

    @pytest.mark.parametrize("kind", KINDS)
    def test_a_silent_host_trips_the_dead_man(self, tmp_path: Path, kind: str) -> None:
        with self.connected(tmp_path) as session, self.beating(session) as beating:
            watchdog_s = _watchdog_s(session)
            if kind not in session.capabilities.watchdog_covers:
                pytest.skip(f"the watchdog is not claimed to cover {kind}")
            excitation = _lasting(session, kind, watchdog_s)
            with pytest.raises(DriveFault) as fault:
                _go_silent_during(beating, excitation, watchdog_s)
            assert fault.value.cause is FaultCause.HEARTBEAT_LOST, f"tripped with cause {fault.value.cause.value}"
            self._require_latched(session)
            session.drive.clear_fault()
            assert session.drive.telemetry().state is DriveState.DISARMED, "not disarmed after clear_fault"
            with self.beating(session):
                assert session.drive.telemetry().state is DriveState.ARMED, "does not arm after clear_fault"

    def _require_latched(self, session: Session) -> None:
        telemetry = session.drive.telemetry()
        assert telemetry.state is DriveState.FAULTED, f"{telemetry.state.value} after a fault"
        assert telemetry.faults, "telemetry names no fault"
        assert abs(session.current_now()) <= self.tolerance_a(session), "a current flows in the faulted state"
        session.drive.heartbeat()
        with pytest.raises(DriveRefused):
            session.drive.arm(session.sizes.limits)
        with pytest.raises(DriveError):
            session.measure(session.sizes.one_of(max(session.capabilities.excitations)))
        session.drive.ramp_down()
        session.drive.disarm()
        assert session.drive.telemetry().state is DriveState.FAULTED, "the fault is not latched"

    def test_a_run_taken_up_again_goes_on_as_it_would_have(self, tmp_path: Path) -> None:
        warm_up, after = "kit-000", {}
        with self.armed(tmp_path) as session:
            session.requires("hold")
            if not isinstance(session.drive, ResumableDrive):
                pytest.skip("this drive claims no checkpoint")
            end_s = session.measure(session.sizes.hold()).end_s
            session.drive.checkpoint(warm_up)
            session.drive.ramp_down()
            session.drive.disarm()
            session.drive.arm(session.sizes.limits)
            after["once"] = session.measure(session.sizes.hold())
        with self.connected(tmp_path) as session:
            assert isinstance(session.drive, ResumableDrive)
            session.drive.restore(warm_up, end_s)
            with self.beating(session):
                after["again"] = session.measure(session.sizes.hold())
                session.drive.ramp_down()
        assert after["again"].start_s >= end_s, "the clock was set back"
        assert after["again"].start_s <= after["once"].start_s + 2.0 * session.sizes.settle_s + 1.0, "the clock jumped"
        self._require_same(session, after["once"], after["again"])

    def _require_same(self, session: Session, once: Measured, again: Measured) -> None:
        for quantity, a, b in (("voltage", once.v_ab, again.v_ab), ("current", once.i_ab, again.i_ab)):
            noise = 5.0 * float(np.hypot(*(a.std(axis=0) + b.std(axis=0)))) / math.sqrt(len(a))
            apart = float(np.hypot(*(a.mean(axis=0) - b.mean(axis=0))))
            allowed = 0.005 * float(np.hypot(*a.mean(axis=0))) + noise
            assert apart <= allowed, f"mean {quantity} differs by {apart:.4g} after restore ({allowed:.2g} allowed)"


def _watchdog_s(session: Session) -> float:
    if session.capabilities.watchdog_s is None:
        pytest.skip("this drive says that it has no watchdog")
    return session.capabilities.watchdog_s


def _past_the_limits(session: Session) -> list[tuple[str, Excitation]]:
    """Excitations that are too large in one way each, of the kinds that the drive claims."""
    sizes, limits = session.sizes, session.sizes.limits
    candidates: list[tuple[str, Excitation]] = [
        ("a hold past the current limit", sizes.hold(current_d_a=1.2 * limits.current_a, current_q_a=0.0)),
        (
            "a hold whose vector is past the current limit, though no axis is",
            sizes.hold(current_d_a=-0.8 * limits.current_a, current_q_a=0.8 * limits.current_a),
        ),
        (
            "a trapezoid that leaves the current limit on its way",
            sizes.trapezoid(held_a=0.8 * limits.current_a, amplitude_a=0.8 * limits.current_a),
        ),
        (
            "an injection about a point past the current limit",
            sizes.injection(target_d_a=0.0, target_q_a=-1.2 * limits.current_a),
        ),
        ("an injection past the voltage limit", sizes.injection(amplitude_v=1.2 * limits.voltage_v)),
    ]
    return [(what, e) for what, e in candidates if e.kind in session.capabilities.excitations]


def _lasting(session: Session, kind: str, watchdog_s: float) -> Excitation:
    """An excitation of this kind over several watchdog times, as far as the drive can capture that long."""
    excitation = session.sizes.one_of(kind)
    if isinstance(excitation, Hold | GatesOff):
        longest = session.capabilities.longest_capture_s or math.inf
        return excitation.model_copy(update={"duration_s": min(max(1.5, 8.0 * watchdog_s), longest)})
    return excitation


def _go_silent_during(session: Session, excitation: Excitation, watchdog_s: float) -> None:
    """Stop the heart after the first rows; the drive trips in this excitation or at the next one."""
    assert session.heart is not None
    under_way = iter(session.drive.execute(excitation))
    while len(next(under_way)) == 0:
        pass
    session.heart.stop()
    time.sleep(1.5 * watchdog_s + 0.05)
    for _ in under_way:
        pass
    session.measure(excitation)

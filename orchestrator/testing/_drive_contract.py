"""Drive checks: the declared capabilities, and that nothing is energised before the command."""

from __future__ import annotations

import math
import time
from pathlib import Path

import pytest
from pydantic import BaseModel

from orchestrator.testing._drive_bench import DriveBench
from protocols import Drive, DriveRefused, DriveState, Limits

ENERGISED = ("hold", "trapezoid", "injection", "steps", "spin")


class DriveContractChecks(DriveBench):
    """Identity, capabilities, arming."""

    def test_entry_point_leads_to_the_drive(self, tmp_path: Path) -> None:
        drive = self.make_drive(self.setup_in(tmp_path))
        self.require_entry_point("fluxbench.drives", type(drive))

    def test_class_keeps_the_contract(self, tmp_path: Path) -> None:
        drive = self.make_drive(self.setup_in(tmp_path))
        assert isinstance(drive, Drive), "methods or attributes of protocols.Drive are missing"
        assert issubclass(drive.Options, BaseModel), "Options must be a pydantic model"
        unknown = set(drive.sealed_options) - set(drive.Options.model_fields)
        assert not unknown, f"sealed_options names what Options does not have: {sorted(unknown)}"

    def test_capabilities_are_coherent(self, tmp_path: Path) -> None:
        with self.connected(tmp_path) as session:
            says = session.capabilities
            assert says.pwm_frequency_hz in says.pwm_frequencies_hz, "pwm_frequencies_hz lacks pwm_frequency_hz"
            assert says.excitations, "a drive without a single excitation is no drive"
            assert says.max_voltage_v <= says.dc_bus_voltage_v * 2.0 / 3.0 * 1.001, (
                "max_voltage_v is more than two thirds of the bus: no bridge reaches that"
            )
            assert says.watchdog_covers <= says.excitations, "watchdog_covers names excitations that are not claimed"
            if says.watchdog_s is None:
                assert not says.watchdog_covers, "watchdog_covers something, but watchdog_s is None"
            else:
                assert says.watchdog_covers, "watchdog_s is given, but it covers nothing"

    def test_connecting_energises_nothing(self, tmp_path: Path) -> None:
        with self.connected(tmp_path) as session:
            telemetry = session.drive.telemetry()
            assert telemetry.state is DriveState.DISARMED, f"{telemetry.state.value} right after connect"
            assert abs(session.current_now()) <= self.tolerance_a(session), "a current flows before arming"

    @pytest.mark.parametrize("kind", ENERGISED)
    def test_excitation_before_arming_is_refused(self, tmp_path: Path, kind: str) -> None:
        with self.connected(tmp_path) as session:
            session.requires(kind)
            with pytest.raises(DriveRefused):
                session.measure(session.sizes.one_of(kind))
            assert abs(session.current_now()) <= self.tolerance_a(session), "refused, but a current flows"

    @pytest.mark.parametrize("quantity", ["current_a", "voltage_v"])
    def test_limits_above_the_drive_s_own_are_refused(self, tmp_path: Path, quantity: str) -> None:
        with self.connected(tmp_path) as session:
            own = {"current_a": session.capabilities.max_current_a, "voltage_v": session.capabilities.max_voltage_v}
            with pytest.raises(DriveRefused):
                session.drive.arm(Limits(**(own | {quantity: 1.1 * own[quantity]})))
            assert session.drive.telemetry().state is DriveState.DISARMED, "armed in spite of its refusal"

    def test_arming_and_disarming_show_in_the_state(self, tmp_path: Path) -> None:
        with self.connected(tmp_path) as session:
            with self.beating(session):
                assert session.drive.telemetry().state is DriveState.ARMED, "not armed after arm"
                session.drive.disarm()
            assert session.drive.telemetry().state is DriveState.DISARMED, "not disarmed after disarm"

    def test_unclaimed_excitations_are_refused(self, tmp_path: Path) -> None:
        with self.armed(tmp_path) as session:
            for kind in sorted({"gates_off", *ENERGISED} - session.capabilities.excitations):
                with pytest.raises(DriveRefused):
                    session.measure(session.sizes.one_of(kind))

    def test_unclaimed_pwm_frequency_is_refused(self, tmp_path: Path) -> None:
        with self.armed(tmp_path) as session:
            session.requires("hold")
            unknown = 1.37 * max(session.capabilities.pwm_frequencies_hz)
            with pytest.raises(DriveRefused):
                session.measure(session.sizes.hold(pwm_frequency_hz=unknown))

    def test_brake_is_moved_or_refused(self, tmp_path: Path) -> None:
        with self.connected(tmp_path) as session:
            if session.capabilities.has_brake:
                session.drive.set_brake(True)
            else:
                with pytest.raises(DriveRefused):
                    session.drive.set_brake(True)

    def test_heartbeat_returns_at_once_in_every_state(self, tmp_path: Path) -> None:
        with self.connected(tmp_path) as session:
            fastest = math.inf
            for _ in range(5):
                begun = time.monotonic()
                session.drive.heartbeat()
                fastest = min(fastest, time.monotonic() - begun)
            assert fastest < 0.05, f"heartbeat takes {fastest:.3f} s"
